"""Points of a phantom seen in tracked images: the usable frames, and why the others are unusable."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration.refusal import RejectedFrame, Rejection
from dvf_ig.core import BoolArray, FloatArray, ImageMap, InvalidInputError, PoseStream, read_only_arrays

from .map_parameters import MapParameters

IndexArray = np.ndarray[tuple[int], np.dtype[np.intp]]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrackedPoints:
    """Frames in which every point was found and the pose is valid, as plain arrays.

    Attributes:
        frames: (f,) indices into the recording.
        pixels: (f, k, 2) column, row of each point.
        rotations, translations_mm: (f, 3, 3), (f, 3) target_from_source: the probe's sensor against a frame
            in which the phantom does not move.
        target, source: names of those frames.
    """

    frames: IndexArray
    pixels: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray
    target: str
    source: str

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def center_px(self) -> FloatArray:
        """(2,) middle of the region in which points were seen."""
        flat = self.pixels.reshape(-1, 2)
        return np.asarray(0.5 * (flat.min(axis=0) + flat.max(axis=0)))

    def part(self, which: BoolArray | IndexArray) -> "TrackedPoints":
        """Select frames by flags or by indices."""
        return TrackedPoints(
            self.frames[which],
            self.pixels[which],
            self.rotations[which],
            self.translations_mm[which],
            self.target,
            self.source,
        )

    def placed_mm(self, probe_from_image: ImageMap) -> FloatArray:
        """Map the points by `probe_from_image` to (f, k, 3) mm in the poses' target frame."""
        flat = probe_from_image.apply_pixels(self.pixels.reshape(-1, 2)).xyz_mm
        at_probe = flat.reshape(*self.pixels.shape[:2], 3)
        return np.asarray(np.einsum("fij,fkj->fki", self.rotations, at_probe) + self.translations_mm[:, None])

    def placed_jacobian(self, parameters: MapParameters) -> FloatArray:
        """Compute the (f, k, 3, count) derivative of `placed_mm` by the map's parameters."""
        rotations = self.rotations @ parameters.estimate.rigid.rotation
        return np.asarray(np.einsum("fij,fkjp->fkip", rotations, parameters.jacobian(self.pixels)))

    def recorded(self, which: BoolArray, count: int) -> BoolArray:
        """Expand (f,) flags of these frames to (count,) flags of the recording's frames."""
        flags = np.zeros(count, dtype=np.bool_)
        flags[self.frames[which]] = True
        return flags


def usable_points(
    poses: PoseStream, points_px: FloatArray, least: int, shown: str = "the target"
) -> TrackedPoints:
    """Select frames with every point found and a valid pose.

    Args:
        poses: (n,) target_from_probe.
        points_px: (n, k, 2) column, row; NaN if a point was not found.
        least: fewest such frames.
        shown: what the points are, for the message.
    Raises:
        InvalidInputError: points of another recording, or fewer than `least` such frames.
    """
    if points_px.ndim != 3 or points_px.shape[0] != len(poses) or points_px.shape[2] != 2:
        raise InvalidInputError(
            f"target points have shape {points_px.shape}; needed ({len(poses)}, points, 2), one row a frame"
        )
    seen = np.isfinite(points_px).all(axis=(1, 2))
    frames = np.flatnonzero(seen & poses.valid)
    if len(frames) < least:
        raise InvalidInputError(
            f"{len(frames)} of {len(poses)} frames are usable ({int(seen.sum())} show {shown}, "
            f"{int(poses.valid.sum())} have a valid {poses.name}), needed at least {least}; record more"
        )
    return TrackedPoints(
        frames, points_px[frames], poses.rotations[frames], poses.translations_mm[frames], poses.target,
        poses.source,
    )  # fmt: skip


def require_same_probe(probe_from_image: ImageMap, poses: PoseStream) -> None:
    """Raise InvalidInputError unless the calibration is of the sensor that was recorded."""
    sensor = probe_from_image.rigid.target
    if sensor != poses.source:
        raise InvalidInputError(
            f"the image calibration belongs to sensor '{sensor}', the recording tracks '{poses.source}'; use "
            "the calibration of the same probe"
        )


def rejected_frames(
    poses: PoseStream,
    points_px: FloatArray,
    outliers: Mapping[int, str],
    missing: Callable[[FloatArray], str],
) -> tuple[tuple[int, RejectedFrame], ...]:
    """List (frame, reason) of every frame of the recording that took no part in the fit, in order.

    Args:
        outliers: by frame, what the residual was.
        missing: describes which of a frame's points (k, 2) were not found.
    """
    seen = np.isfinite(points_px).all(axis=(1, 2))
    out = {int(i): RejectedFrame(Rejection.NOT_FOUND, missing(points_px[i])) for i in np.flatnonzero(~seen)}
    for i in np.flatnonzero(seen & ~poses.valid):
        out[int(i)] = RejectedFrame(Rejection.POSE_INVALID, f"{poses.name} is not valid")
    for frame, detail in outliers.items():
        out[frame] = RejectedFrame(Rejection.OUTLIER, detail)
    return tuple(sorted(out.items()))
