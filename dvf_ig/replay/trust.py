"""Whether a registration that believes itself may guide: it must agree with what is known without its images.

A wrong probe calibration, a marker that slipped on the probe and a patient who moved all leave images that
match the model well. What they do not leave alone is the place: landmarks touched with another tool disagree
at once, and the pose jumps or wanders from one registration to the next as the probe turns.
"""

from dataclasses import dataclass, replace

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration import HEART_RADIUS_MM, distance_between

LANDMARKS_MM = 4.0
"""Landmark fits of tuning seeds 101–106 lie 0.9 to 1.4 mm from the truth over the heart, good poses 2 mm."""
JUMP_MM = 2.5
"""Refreshes of an undisturbed patient move by up to 1.2 mm."""
CONFIRMED_MM = 1.25


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """What the next registration is held against.

    Attributes:
        center_mm: (3,) centre of the heart box, frame "mr".
        landmarks: mr_from_tracker from landmarks touched before the first registration; None without any.
        in_use: the pose that guides; None before the first, and while it is withheld.
        unconfirmed: a pose far from the one that was in use, waiting for a second one like it.
    """

    center_mm: FloatArray
    landmarks: Rigid | None
    in_use: Rigid | None = None
    unconfirmed: Rigid | None = None

    def judged(self, pose: Rigid) -> tuple["Trust", str]:
        """The next state, and why `pose` may not guide; an empty reason where it may."""
        if self.unconfirmed is not None:
            off_mm = self._apart(pose, self.unconfirmed)
            if off_mm <= CONFIRMED_MM:
                return replace(self, in_use=pose, unconfirmed=None), ""
            return replace(self, unconfirmed=pose), (
                f"the pose still wanders, by {off_mm:.1f} mm since the last registration; check the probe's "
                "marker and calibration"
            )
        if self.in_use is not None:
            off_mm = self._apart(pose, self.in_use)
            if off_mm <= JUMP_MM:
                return replace(self, in_use=pose), ""
            return replace(self, in_use=None, unconfirmed=pose), (
                f"patient or probe moved by {off_mm:.1f} mm; withheld until a second registration confirms it"
            )
        if self.landmarks is not None:
            off_mm = self._apart(pose, self.landmarks)
            if off_mm > LANDMARKS_MM:
                return self, (
                    f"the touched landmarks lie {off_mm:.1f} mm from where the images put them; check the "
                    "probe's calibration, or touch the landmarks again"
                )
        return replace(self, in_use=pose), ""

    def _apart(self, first: Rigid, second: Rigid) -> float:
        return distance_between(first, second, self.center_mm, HEART_RADIUS_MM)
