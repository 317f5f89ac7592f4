"""The pre-operative anatomy in ultrasound planes, before and after registration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    DvfModel,
    FloatArray,
    Grid,
    ImageMap,
    Rigid,
    Volume,
    VolumeSeries,
    Warp,
    nearest_phase,
    read_only_arrays,
)
from dvf_ig.guidance import Evaluator, Sigmoid
from dvf_ig.kernels.spline import spline_batch
from dvf_ig.registration import BoundaryTarget
from dvf_ig.report.plane_marks import edge_letters, plane_name
from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay
from dvf_ig.session import GatedFrames, Heart

DARK_PERCENT, BRIGHT_PERCENT = 1.0, 99.5
"""Grey levels of the anatomy that are shown black and in full colour."""
LONGEST_PX = 400
"""Approximate size of a picture; larger images are thinned to every second, third, … pixel."""
NO_GREY_LEVELS = "No grey-level MR was given: colour shows where the model has blood."
SAMPLED = 200_000
"""Approximate number of voxels that the statistics sample."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Anatomy:
    """Pre-operative anatomy in which ultrasound planes are shown.

    Attributes:
        name: name of its grey levels for the reader: "MR".
        remark: note for the reader; empty without one.
        grid, values, fractions: (n, nx, ny, nz) grey levels, and position of each image in the cycle.
        window: grey levels shown black and in full colour.
        evaluator: evaluator of the fixture model; None without a model.
        blood: the surface of the blood; None if not known.
        outline_levels: grey levels, 0 to 1 in the window, whose contours replace a model.
        model: whose labels are shown at the registered pose; warp: the change of shape that it follows.
    """

    name: str
    remark: str
    grid: Grid
    values: AnyArray
    fractions: FloatArray
    window: tuple[float, float]
    evaluator: Evaluator | None = None
    blood: BoundaryTarget | None = None
    outline_levels: tuple[float, ...] = ()
    model: DvfModel | None = None
    warp: Warp | None = None

    def labels(self, pose: Rigid, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8] | None:
        """Look up the labels at (rows, columns, 3) positions of the pose's source frame; None without any."""
        if self.model is None or self.model.tissue is None:
            return None
        there, tissue = pose.apply_array(xyz_mm.reshape(-1, 3)), self.model.tissue
        if self.warp is not None:
            there, tissue = self.warp.model_places(there), tissue.contracting(self.warp.contraction)
        values = tissue.label_at(there, model_phase, self.model.timing)
        return values.astype(np.uint8).reshape(xyz_mm.shape[:2])

    def plane(self, pose: Rigid, xyz_mm: FloatArray, model_phase: float) -> AnatomyPlane:
        """Sample the anatomy at (rows, columns, 3) positions of the pose's source frame."""
        shape, flat = xyz_mm.shape[:2], xyz_mm.reshape(-1, 3)
        there = pose.apply_array(flat)
        distance = blood = None
        if self.evaluator is not None:
            distance = self.evaluator.force_through(pose, flat, model_phase).distance_mm
        if self.blood is not None:
            blood = _blood_mm(self.blood, there, model_phase)
        if self.model is not None and self.model.seen is not None:
            nearest = int(nearest_phase(self.model.timing.fractions, np.array([model_phase]))[0])
            seen = self.model.seen.holds(there, nearest)
            distance, blood = (
                None if values is None else np.where(seen, values, np.nan) for values in (distance, blood)
            )
        right, down = (
            pose.rotation @ (xyz_mm[0, -1] - xyz_mm[0, 0]),
            pose.rotation @ (xyz_mm[-1, 0] - xyz_mm[0, 0]),
        )
        return AnatomyPlane(
            self._grey(there, model_phase).reshape(shape),
            None if distance is None else distance.reshape(shape),
            None if blood is None else blood.reshape(shape),
            edge_letters(right, down),
        )

    def _grey(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        nearest = int(nearest_phase(self.fractions, np.array([model_phase]))[0])
        index = self.grid.to_index(xyz_mm)
        inside = self.grid.holds(index)
        image = self.values[nearest].astype(np.float32)
        level = ndimage.map_coordinates(image, index.T, order=1, mode="nearest")
        low, high = self.window
        return np.where(inside, np.clip((level - low) / max(high - low, 1e-12), 0.0, 1.0), np.nan)


def anatomy_of_heart(heart: Heart, mr: VolumeSeries | None, warp: Warp | None = None) -> Anatomy:
    """Show a heart's model with its MR, or without one, with the blood inside its surfaces.

    Args:
        warp: change of shape through which labels are shown.
    """
    fixture = Evaluator(heart.model, Sigmoid(), blend="distance", withhold_unseen=False)
    if mr is not None:
        window = _window(mr.values)
        return Anatomy(
            "MR",
            "",
            mr.grid,
            mr.values,
            mr.timing.fractions,
            window,
            fixture,
            heart.surface,
            model=heart.model,
            warp=warp,
        )
    channels = heart.channels
    blood = channels.values[..., 0]
    window = float(blood.min()), float(blood.max())
    return Anatomy(
        "blood",
        NO_GREY_LEVELS,
        channels.grid,
        blood,
        channels.fractions,
        window,
        fixture,
        heart.surface,
        model=heart.model,
        warp=warp,
    )


def anatomy_of_image(image: Volume, name: str) -> Anatomy:
    """Show an image of an organ that does not beat, without a model."""
    low, high = _window(image.values)
    shown = np.clip((_sample(image.values) - low) / max(high - low, 1e-12), 0.0, 1.0)
    levels = _outline_levels(shown)
    still = np.zeros(1)
    return Anatomy(name, "", image.grid, image.values[None], still, (low, high), outline_levels=levels)


def plane_overlay(
    anatomy: Anatomy,
    start: Rigid,
    registered: Rigid,
    image: NDArray[np.uint8],
    frame_from_pixel: FloatArray,
    *,
    name: str,
    event_s: float | None = None,
    model_phase: float | None = None,
) -> PlaneOverlay:
    """Overlay an ultrasound image with the anatomy in its plane.

    Args:
        start, registered: poses from the ultrasound's frame.
        image: (rows, columns) grey levels.
        frame_from_pixel: (3, 3) mm from (column, row, 1).
        name: name of the image for the reader.
    """
    step = max(1, max(image.shape) // LONGEST_PX)
    image = image[::step, ::step]
    frame_from_pixel = frame_from_pixel @ np.diag([step, step, 1.0])
    rows, columns = image.shape
    column, row = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    xyz_mm = np.stack([column, row, np.ones_like(row)], axis=-1) @ frame_from_pixel.T
    right, down = frame_from_pixel[:, 0], frame_from_pixel[:, 1]
    phase = 0.0 if model_phase is None else model_phase
    tissue = None if anatomy.model is None else anatomy.model.tissue
    placed = registered.rotation @ frame_from_pixel
    placed[:, 2] += registered.translation_mm
    return PlaneOverlay(
        name=name,
        plane=plane_name(registered.rotation @ np.cross(right, down)),
        event_s=event_s,
        model_phase=model_phase,
        image=image,
        pixel_mm=(float(np.linalg.norm(right)), float(np.linalg.norm(down))),
        start=anatomy.plane(start, xyz_mm, phase),
        registered=anatomy.plane(registered, xyz_mm, phase),
        outline_levels=anatomy.outline_levels,
        anatomy_from_pixel=placed,
        labels=anatomy.labels(registered, xyz_mm, phase),
        label_names=() if tissue is None else tissue.names,
    )


def frame_overlays(
    frames: GatedFrames,
    images: NDArray[np.uint8],
    probe_from_image: ImageMap,
    anatomy: Anatomy,
    start: Rigid,
    registered: Rigid,
    *,
    count: int = 4,
) -> list[PlaneOverlay]:
    """Overlay `count` of the used frames, evenly spread between the first and the last of the sweep.

    Args:
        images: (n, rows, columns) of every frame since the stream began.
        start, registered: mr_from_tracker.
    """
    probe_from_pixel = probe_from_image.matrix[:3, [0, 1, 3]]
    used = frames.used
    chosen = used[np.linspace(0, len(used) - 1, count + 2).astype(int)[1:-1]].tolist()
    overlays = []
    for frame in chosen:
        tracker_from_pixel = frames.rotations[frame] @ probe_from_pixel
        tracker_from_pixel[:, 2] += frames.translations_mm[frame]
        number = frames.first_number + frame
        overlays.append(
            plane_overlay(
                anatomy,
                start,
                registered,
                images[number],
                tracker_from_pixel,
                name=f"frame {number}",
                event_s=float(frames.event_s[frame]),
                model_phase=float(frames.model_phase[frame]),
            )
        )
    return overlays


def _blood_mm(blood: BoundaryTarget, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
    """Compute (n,) signed distances to the blood's surface, positive inside; NaN outside its box."""
    knots = xyz_mm @ blood.knots_from_mm[:, :3].T + blood.knots_from_mm[:, 3]
    phase = int(blood.nearest_phase(np.array([model_phase]))[0])
    distance_mm, gradient = np.empty(len(knots)), np.empty((len(knots), 3))
    status = np.empty(len(knots), dtype=np.int64)
    spline_batch(blood.coefficients, np.zeros(3), 1.0, phase, knots, distance_mm, gradient, status)
    return distance_mm


def _sample(values: AnyArray) -> FloatArray:
    """Sample about SAMPLED finite voxels."""
    flat = values.reshape(-1)
    sample = np.asarray(flat[:: max(1, flat.size // SAMPLED)], dtype=np.float64)
    return np.asarray(sample[np.isfinite(sample)])


def _window(values: AnyArray) -> tuple[float, float]:
    """Choose the grey levels shown black and in full."""
    low, high = np.percentile(_sample(values), [DARK_PERCENT, BRIGHT_PERCENT])
    return float(low), float(high)


def _outline_levels(shown: FloatArray) -> tuple[float, ...]:
    """Find two grey levels between three classes of tissue (Otsu 1979); none in an image with fewer."""
    from skimage.filters import threshold_multiotsu

    try:
        return tuple(float(level) for level in threshold_multiotsu(shown, classes=3))
    except ValueError:  # fewer than three grey levels
        return ()
