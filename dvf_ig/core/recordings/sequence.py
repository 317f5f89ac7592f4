"""Tracked ultrasound: an image sequence as PLUS and 3D Slicer record it, or one gated volume."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.space.volume import Volume

from .stream import PoseStream


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Insonified sector in pixels of the B-mode image, from the scanner's geometry.

    Attributes:
        apex_px: (2,) column, row of the point where the outermost lines meet.
        start_px, stop_px: radii from the apex, along rows of isotropic pixels.
        half_angle_rad: half opening angle about the downward image axis.
    """

    apex_px: FloatArray
    start_px: float
    stop_px: float
    half_angle_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "apex_px", frozen_floats(self.apex_px, "fan apex", (2,)))
        if not 0 <= self.start_px < self.stop_px:
            raise InvalidInputError(
                f"fan radii are {self.start_px:g} to {self.stop_px:g} px; needed 0 <= start < stop"
            )

    def mask(self, rows: int, columns: int) -> BoolArray:
        """Mark (rows, columns) pixels inside the sector."""
        row, column = np.mgrid[:rows, :columns]
        dx, dy = column - self.apex_px[0], row - self.apex_px[1]
        radius, angle = np.hypot(dx, dy), np.arctan2(dx, dy)
        inside = (radius >= self.start_px) & (radius <= self.stop_px)
        return np.asarray(inside & (np.abs(angle) <= self.half_angle_rad))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrackedSequence:
    """Image frames with time stamps and the poses recorded with them.

    Attributes:
        t_s: (n,) frame time stamps, video clock, strictly increasing (frame index if the file has none).
        images: (n, rows, columns) uint8, or None for a pose-only recording.
        image_valid: (n,) False if the recorder marked the image INVALID.
        poses: streams by name, e.g. "tracker_from_probe"; their `t_s` equals this sequence's.
        has_timestamps: False if the file has none.
        orientation: PLUS orientation of the images, e.g. "MFA"; "XX" if unknown.
        turned_from: orientation in which a file stores the images, if they were turned when it was read.
        image_maps: (4, 4) fixed transforms from or to pixels that were recorded with the images, by name.
    """

    t_s: FloatArray
    images: NDArray[np.uint8] | None
    image_valid: BoolArray
    poses: dict[str, PoseStream]
    has_timestamps: bool = True
    orientation: str = "MFA"
    turned_from: str | None = None
    image_maps: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "frame times", (None,))
        if len(t_s) == 0:
            raise InvalidInputError("the sequence has no frames")
        if (np.diff(t_s) <= 0).any():
            raise InvalidInputError("frame times do not increase strictly; drop repeated frames")
        if self.images is not None:
            if self.images.ndim != 3 or len(self.images) != len(t_s) or self.images.dtype != np.uint8:
                raise InvalidInputError(
                    f"images have shape {self.images.shape} and type {self.images.dtype}; "
                    f"needed ({len(t_s)}, rows, columns) of uint8"
                )
            self.images.setflags(write=False)
        for name, stream in self.poses.items():
            if name != stream.name or not np.array_equal(stream.t_s, t_s):
                raise InvalidInputError(f"pose stream '{name}' does not belong to this sequence's frames")
        object.__setattr__(self, "t_s", t_s)
        valid = frozen(self.image_valid, "image status", (len(t_s),), np.bool_)
        object.__setattr__(self, "image_valid", valid)

    def __len__(self) -> int:
        return len(self.t_s)

    def stream(self, target: str, source: str) -> PoseStream:
        """Return target_from_source: recorded directly, inverted, or joined through one shared frame.

        PLUS records ProbeToTracker and ReferenceToTracker; `stream("reference", "probe")` joins them.

        Raises:
            InvalidInputError: the recorded transforms do not connect the two frames.
        """
        direct = self._one_step(target, source)
        if direct is not None:
            return direct
        frames = sorted({f for s in self.poses.values() for f in (s.target, s.source)} - {target, source})
        for middle in frames:
            first, second = self._one_step(target, middle), self._one_step(middle, source)
            if first is not None and second is not None:
                return first @ second
        recorded = ", ".join(sorted(self.poses)) or "none"
        raise InvalidInputError(
            f"the sequence has no transform {target}_from_{source}; it records {recorded}"
        )

    def _one_step(self, target: str, source: str) -> PoseStream | None:
        forward = self.poses.get(f"{target}_from_{source}")
        if forward is not None:
            return forward
        backward = self.poses.get(f"{source}_from_{target}")
        return backward.inverse() if backward is not None else None


@dataclass(frozen=True, slots=True, eq=False)
class TrackedVolume:
    """Gated 3-D ultrasound image, with its pose and its phase of the model.

    Attributes:
        image: uint8 log-compressed grey levels, in the frame of the transducer.
        mask: non-zero if a voxel was insonified, on the same grid.
        tracker_from_image: pose of the image's frame.
        model_phase: position in the model's cycle at which it was taken, [0, 1).
        t_s: event time.
    """

    image: Volume
    mask: Volume
    tracker_from_image: Rigid
    model_phase: float
    t_s: float = 0.0

    def __post_init__(self) -> None:
        if self.image.values.dtype != np.uint8:
            raise InvalidInputError(
                f"a tracked ultrasound volume holds {self.image.values.dtype}; needed uint8 grey levels"
            )
        if self.mask.values.shape != self.image.values.shape:
            raise InvalidInputError(
                f"the mask has shape {self.mask.values.shape}, the volume {self.image.values.shape}; "
                "needed the same grid"
            )
        if not 0.0 <= self.model_phase < 1.0:
            raise InvalidInputError(f"the model phase is {self.model_phase:g}; needed 0 to below 1")
        require_same_frame(self.image.grid.frame, self.tracker_from_image.source, "tracked volume")
