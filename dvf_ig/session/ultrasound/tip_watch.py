"""The tool's tip in the ultrasound that has arrived, beat by beat: a check of calibrations on the patient."""

from collections import deque

import numpy as np

from dvf_ig.core import BoolArray, Fan, FloatArray, PoseStream, TrackedSequence
from dvf_ig.core.space.rigid import is_rigid
from dvf_ig.registration import (
    BESIDE_MM,
    IN_PLANE_MM,
    TipPatches,
    TipSighting,
    fan_mask_from_images,
    patch_around,
    sighting,
    tip_view,
)
from dvf_ig.session.calibrations import CalibrationsInUse
from dvf_ig.session.events import ToolPose

from .frame_buffer import FrameBuffer
from .gated_frames import fan_mask

KEEP_S = 5.0
"""Tool poses older than this are forgotten: longer than a heart beat."""


class TipWatch:
    """Takes the tool's poses, and says of each beat where the last ones showed the tip.

    Args:
        frames: those that have arrived.
        calibrations: that place image and tip.
        fan: the insonified sector, where the scanner's geometry is known.
    """

    def __init__(self, frames: FrameBuffer, calibrations: CalibrationsInUse, fan: Fan | None) -> None:
        self._frames = frames
        self._calibrations = calibrations
        self._fan = fan
        self._tool: deque[ToolPose] = deque()
        self._looked_s = -np.inf
        """Images of up to then have been looked at."""
        self._patches = TipPatches.none()
        self.seen: TipSighting | None = None
        """Where the images up to the last beat show the tip; None where they do not."""

    def push(self, pose: ToolPose) -> None:
        """Take one pose; one that is not later than all before is dropped."""
        if not self._tool or pose.t_s > self._tool[-1].t_s:
            self._tool.append(pose)

    def after_beat(self, until_s: float, known_s: float) -> TipSighting | None:
        """Look at the images of a beat.

        Args:
            until_s: event time of its end.
            known_s: frames and tool poses that were recorded later are not looked at.
        """
        while self._tool and self._tool[0].t_s < until_s - KEEP_S:
            self._tool.popleft()
        from_s, self._looked_s = max(self._looked_s, until_s - KEEP_S), until_s
        tool = self._tool_until(known_s)
        found = self._frames.between(from_s - max(0.0, self._calibrations.lag_s), known_s)
        if tool is not None and found is not None:
            self._patches = self._patches.after(*self._looked_at(found[0], tool, from_s, until_s))
        self.seen = sighting(self._patches)
        return self.seen

    def _tool_until(self, known_s: float) -> PoseStream | None:
        poses = [pose for pose in self._tool if pose.t_s <= known_s]
        if not poses:
            return None
        matrices, valid = np.tile(np.eye(4), (len(poses), 1, 1)), np.zeros(len(poses), dtype=np.bool_)
        for i, pose in enumerate(poses):
            if pose.tracker_from_tool is not None and is_rigid(pose.tracker_from_tool):
                matrices[i], valid[i] = pose.tracker_from_tool, True
        t_s = np.array([pose.t_s for pose in poses])
        return PoseStream("tracker", "tool", t_s, matrices[:, :3, :3], matrices[:, :3, 3], valid)

    def _looked_at(
        self, ultrasound: TrackedSequence, tool: PoseStream, from_s: float, until_s: float
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Patches of the images whose plane holds the tip, and of those beside which it lies."""
        in_plane: list[FloatArray] = []
        beside: list[FloatArray] = []
        images, calibrations = ultrasound.images, self._calibrations
        if images is None:
            return in_plane, beside
        event_s = ultrasound.t_s + calibrations.lag_s
        (probe,) = ultrasound.poses.values()
        turns, places, tracked = probe.at_many(event_s)
        tool_turns, tool_places, seen = tool.at_many(event_s)
        usable = ultrasound.image_valid & tracked & seen & (event_s > from_s) & (event_s <= until_s)
        tip = calibrations.tip.xyz_mm[0]
        sector: BoolArray | None = None
        for i in np.flatnonzero(usable):
            tip_tracker_mm = tool_turns[i] @ tip + tool_places[i]
            view = tip_view((tip_tracker_mm - places[i]) @ turns[i], calibrations.probe_from_image)
            off_mm = abs(view.beside_mm)
            if off_mm <= IN_PLANE_MM:
                kind = in_plane
            elif BESIDE_MM[0] <= off_mm <= BESIDE_MM[1]:
                kind = beside
            else:
                continue
            if sector is None:
                sector = (
                    fan_mask_from_images(images)
                    if self._fan is None
                    else fan_mask(self._fan, *images.shape[1:])
                )
            patch = patch_around(images[i], sector, view, calibrations.probe_from_image.scale_mm_per_px)
            if patch is not None:
                kind.append(patch)
        return in_plane, beside
