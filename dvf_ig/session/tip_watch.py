"""The tool's tip in the ultrasound that has arrived, beat by beat: a check of calibrations on the patient."""

from collections import deque
from itertools import takewhile

import numpy as np

from dvf_ig.core import Fan, FloatArray, PoseStream, TrackedSequence
from dvf_ig.core.recordings.stream import MAX_GAP_S
from dvf_ig.registration import TipPatches, TipSighting, TipView, patch_around, sighting, tip_view

from .arrived_ultrasound import KEEP_S as FRAMES_KEPT_S
from .arrived_ultrasound import FrameBuffer
from .events import ToolPose
from .gated_frames import sector_of
from .setup import CalibrationsInUse

KEEP_S = 5.0
"""Images older than this are ignored: longer than a heart beat."""


class TipWatch:
    """Locates the tool's tip in the images of each beat, from the tool's poses.

    Args:
        frames: those that have arrived.
        calibrations: of image and tip.
        fan: the insonified sector, where the scanner's geometry is known.
    """

    def __init__(self, frames: FrameBuffer, calibrations: CalibrationsInUse, fan: Fan | None) -> None:
        self._frames = frames
        self._calibrations = calibrations
        self._fan = fan
        self._tool: deque[ToolPose] = deque()
        self._searched_s = -np.inf
        """Time up to which images have been searched."""
        self._patches = TipPatches.none()
        self.seen: TipSighting | None = None
        """Where the last images near the tip show it; None if they do not."""

    def push(self, pose: ToolPose) -> None:
        """Add one pose; one that is not later than all before is dropped."""
        if not self._tool or pose.t_s > self._tool[-1].t_s:
            self._tool.append(pose)

    def advance(self, now_s: float) -> None:
        """Forget poses that belong to no remaining frame; times in order. Beats may never come."""
        while self._tool and self._tool[0].t_s < now_s - FRAMES_KEPT_S:
            self._tool.popleft()

    def after_beat(self, until_s: float, known_s: float) -> TipSighting | None:
        """Search the images of a beat for the tip.

        Args:
            until_s: event time of its end.
            known_s: frames and tool poses that were recorded later are ignored.
        Returns:
            where they show the tip, with those before; None if they do not, or none passed near it.
        """
        from_s, self._searched_s = max(self._searched_s, until_s - KEEP_S), until_s
        while self._tool and self._tool[0].t_s < from_s - MAX_GAP_S:
            self._tool.popleft()
        tool = self._tool_until(min(known_s, until_s + MAX_GAP_S))
        if tool is None:
            return None
        arrived = self._frames.between(from_s - max(0.0, self._calibrations.lag_s), known_s)
        images = [] if arrived is None else self._patches_of(arrived[0], tool, from_s, until_s)
        if not images:
            return None
        self._patches = self._patches.after(images)
        self.seen = sighting(self._patches)
        return self.seen

    def _tool_until(self, last_s: float) -> PoseStream | None:
        """Return the remembered poses until then; None without any."""
        poses = list(takewhile(lambda pose: pose.t_s <= last_s, self._tool))
        if not poses:
            return None
        t_s = np.array([pose.t_s for pose in poses])
        return PoseStream.of_matrices("tracker", "tool", t_s, [pose.tracker_from_tool for pose in poses])

    def _patches_of(
        self, ultrasound: TrackedSequence, tool: PoseStream, from_s: float, until_s: float
    ) -> list[tuple[float, FloatArray]]:
        """Return the distance of the tip from the plane of each image near it, and the patch around it."""
        images, scale = ultrasound.images, self._calibrations.probe_from_image.scale_mm_per_px
        views = self._views(ultrasound, tool, from_s, until_s)
        if images is None or not views:
            return []
        sector = sector_of(self._fan, images)
        patches = [(view.beside_mm, patch_around(images[i], sector, view, scale)) for i, view in views]
        return [(out_of_plane_mm, patch) for out_of_plane_mm, patch in patches if patch is not None]

    def _views(
        self, ultrasound: TrackedSequence, tool: PoseStream, from_s: float, until_s: float
    ) -> list[tuple[int, TipView]]:
        """Find images near the tip whose event is in (from_s, until_s]."""
        event_s = ultrasound.t_s + self._calibrations.lag_s
        (probe,) = ultrasound.poses.values()
        turns, shifts, tracked = probe.at_many(event_s)
        tool_turns, tool_shifts, seen = tool.at_many(event_s)
        usable = ultrasound.image_valid & tracked & seen & (event_s > from_s) & (event_s <= until_s)
        tip_tracker_mm = tool_turns @ self._calibrations.tip.xyz_mm[0] + tool_shifts
        tip_probe_mm = np.einsum("nji,nj->ni", turns, tip_tracker_mm - shifts)
        image = self._calibrations.probe_from_image
        views = [(int(i), tip_view(tip_probe_mm[i], image)) for i in np.flatnonzero(usable)]
        return [(i, view) for i, view in views if view.near]
