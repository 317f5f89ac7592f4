"""Whether a pose may guide: it must agree with what is known without its images, and with every beat since.

A wrong probe calibration, a marker that slipped on the probe and a patient who moved all leave images that
match the model well at some pose. What they do not leave alone is the place: landmarks touched with another
tool disagree at once, the next heart beat is explained better by another pose, and after a slip no pose
explains the views of several beats.

    guiding ── a beat it does not explain, or a registration elsewhere ──► in doubt: no force
    in doubt ── beats in a row that it, or a registration made since, explains ──► guiding
"""

from dataclasses import dataclass, replace

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration import BeatMeasurement, PoseEstimate, mean_displacement_mm

LANDMARKS_MM = 4.0
"""Landmark fits of tuning seeds 101–106 lie 0.9 to 1.4 mm from the truth over the heart, good poses 2 mm."""
JUMP_MM = 2.5
"""Refreshes of an undisturbed patient move by up to 1.2 mm."""
SURPRISE = 7.0
"""Log likelihood ratio of a beat from which another pose is believed instead. On tuning seed 101, calm and
with poor images, 170 beats reach 4.4; of beats after a shift of 8 mm, 95 % lie above 9."""
EXPLAINED = 5.0
"""The same for a pose that is to guide (again): beats of good poses on tuning seeds reach 4.4."""
CONFIRMING, MOST_CONFIRMING = 3, 10
"""Beats in a row that confirm a pose, and twice as many after each registration that beats contradicted: a
patient who moved lies still again, but a slipped marker is wrong in another way from view to view."""


def disagreeing_landmarks(pose: Rigid, landmarks: Rigid | None, center_mm: FloatArray) -> str:
    """Why a first pose may not guide beside the landmark fit; empty where it may, or none were touched."""
    off_mm = 0.0 if landmarks is None else mean_displacement_mm(pose, landmarks, center_mm)
    if off_mm <= LANDMARKS_MM:
        return ""
    return (
        f"the touched landmarks lie {off_mm:.1f} mm from where the images put them; check the "
        "probe's calibration, or touch the landmarks again"
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """What the next beat and the next registration are held against.

    Attributes:
        center_mm: (3,) centre of the heart box, frame "mr".
        landmarks: mr_from_tracker from landmarks touched before the first registration; None without any.
        belief: the pose that guides, or that did until it came in doubt; None before the first.
        candidate: a registration that waits for beats which it explains.
        doubtful: no force may come from `belief`.
        explained: beats in a row that the pose on trial explains; it guides after `confirming`.
    """

    center_mm: FloatArray
    landmarks: Rigid | None
    belief: PoseEstimate | None = None
    candidate: PoseEstimate | None = None
    doubtful: bool = True
    explained: int = 0
    confirming: int = CONFIRMING

    @property
    def on_trial(self) -> PoseEstimate | None:
        """The pose that a beat is asked about."""
        return self.candidate or self.belief

    @property
    def guiding(self) -> PoseEstimate | None:
        return None if self.doubtful else self.belief

    def registered(self, found: PoseEstimate, beats: float) -> tuple["Trust", str]:
        """The next state after a registration `beats` old in the middle, and why it does not guide yet."""
        if self.doubtful or self.belief is None:
            return self._tried(found)
        off_mm = mean_displacement_mm(found.pose, self.belief.pose, self.center_mm)
        if off_mm <= JUMP_MM:
            return replace(self, belief=self.belief.update_with(found.predict(beats))), ""
        doubted = replace(self, candidate=found, doubtful=True, explained=0)
        return doubted, f"patient or probe moved by {off_mm:.1f} mm; withheld until heart beats confirm it"

    def _tried(self, found: PoseEstimate) -> tuple["Trust", str]:
        """Landmarks are asked about the first pose only: a patient who moved took them along."""
        disagreement = disagreeing_landmarks(found.pose, self.landmarks, self.center_mm)
        if self.belief is None and disagreement:
            return self, disagreement
        return replace(self, candidate=found, explained=0), "waits for heart beats that confirm it"

    def saw(self, look: BeatMeasurement) -> "Trust":
        """After a beat that was asked about the pose on trial."""
        asked = self.on_trial
        if asked is None:
            return self
        if not self.doubtful:
            if look.log_likelihood_ratio > SURPRISE:
                return replace(self, doubtful=True, explained=0)
            return replace(self, belief=_fused(asked, look))
        if look.log_likelihood_ratio > EXPLAINED:
            return self._contradicted()
        if self.explained + 1 < self.confirming:
            return replace(self, explained=self.explained + 1)
        return Trust(self.center_mm, self.landmarks, belief=_fused(asked, look), doubtful=False)

    def _contradicted(self) -> "Trust":
        if self.candidate is None:
            return replace(self, explained=0)
        confirming = min(2 * self.confirming, MOST_CONFIRMING)
        return replace(self, candidate=None, explained=0, confirming=confirming)


def _fused(asked: PoseEstimate, look: BeatMeasurement) -> PoseEstimate:
    return asked.predict(1.0).update(look.offset_information_mm, look.information)
