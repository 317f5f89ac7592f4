"""What a fixed target (a point, a plane) shows in tracked images: usable frames, errors, reasons."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration.error_summary import summarise
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, PoseStream, read_only_arrays


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Frames that show the target, as plain arrays.

    Attributes:
        frames: (f,) indices into the recording.
        pixels: (f, k, 2) column, row of each of the target's k points.
        rotations, translations_mm: (f, 3, 3), (f, 3) tracker_from_probe.
        target, source: frames of the poses.
    """

    frames: np.ndarray[tuple[int], np.dtype[np.intp]]
    pixels: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray
    target: str
    source: str

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def center_px(self) -> FloatArray:
        """(2,) middle of the region in which the target was seen."""
        flat = self.pixels.reshape(-1, 2)
        return np.asarray(0.5 * (flat.min(axis=0) + flat.max(axis=0)))

    def part(self, which: np.ndarray[tuple[int], np.dtype[np.bool_ | np.intp]]) -> "Views":
        return Views(
            self.frames[which],
            self.pixels[which],
            self.rotations[which],
            self.translations_mm[which],
            self.target,
            self.source,
        )

    def placed_mm(self, image_map: ImageMap) -> FloatArray:
        """(f, k, 3) the points where `image_map` puts them, in the poses' target frame."""
        flat = image_map.apply_pixels(self.pixels.reshape(-1, 2)).xyz_mm
        at_probe = flat.reshape(*self.pixels.shape[:2], 3)
        return np.asarray(np.einsum("fij,fkj->fki", self.rotations, at_probe) + self.translations_mm[:, None])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TargetErrors:
    """How far a calibration puts the target's points from the target.

    Attributes:
        mean_mm, sd_mm: over all usable frames.
        mean95_mm, sd95_mm: over the lowest 95 % of them.
        frames_used: frames with the target seen and a valid pose.
        frames: frames recorded.
        errors_mm: (frames_used,) RMS over the frame's points.
    """

    mean_mm: float
    sd_mm: float
    mean95_mm: float
    sd95_mm: float
    frames_used: int
    frames: int
    errors_mm: FloatArray


def usable_views(poses: PoseStream, points_px: FloatArray, least: int) -> Views:
    """Frames with every point of the target found and a valid pose.

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
            f"{len(frames)} of {len(poses)} frames are usable ({int(seen.sum())} show the target, "
            f"{int(poses.valid.sum())} have a valid {poses.name}), needed at least {least}; record more"
        )
    return Views(
        frames, points_px[frames], poses.rotations[frames], poses.translations_mm[frames], poses.target,
        poses.source,
    )  # fmt: skip


def same_sensor(probe_from_image: ImageMap, poses: PoseStream) -> None:
    """Raise InvalidInputError unless the calibration is of the sensor that was recorded."""
    sensor = probe_from_image.rigid.target
    if sensor != poses.source:
        raise InvalidInputError(
            f"the image calibration belongs to sensor '{sensor}', the recording tracks '{poses.source}'; use "
            "the calibration of the same probe"
        )


def rejections(
    poses: PoseStream, points_px: FloatArray, views: Views, misses_mm: FloatArray, limit_mm: float
) -> tuple[tuple[int, str], ...]:
    """(frame, reason) of every frame of the recording that took no part in the fit.

    Args:
        misses_mm: (f,) miss of each usable frame; `limit_mm` is the largest one kept.
    """
    seen = np.isfinite(points_px).all(axis=(1, 2))
    out = [(int(i), "the target was not found in the image") for i in np.flatnonzero(~seen)]
    out += [(int(i), f"{poses.name} is not valid") for i in np.flatnonzero(seen & ~poses.valid)]
    out += [
        (int(i), f"it misses the target by {miss:.2f} mm, others by at most {limit_mm:.2f} mm")
        for i, miss in zip(views.frames, misses_mm, strict=True)
        if miss > limit_mm
    ]
    return tuple(sorted(out))


def target_errors(errors_mm: FloatArray, frames: int) -> TargetErrors:
    """Summary of one error a frame, of a recording of `frames`."""
    summary = summarise(errors_mm)
    return TargetErrors(
        summary.mean_mm,
        summary.sd_mm,
        summary.mean95_mm,
        summary.sd95_mm,
        len(errors_mm),
        frames,
        np.asarray(errors_mm),
    )
