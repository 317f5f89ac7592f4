"""N-wire calibration from images alone: the wires of every frame, or why a frame was left out."""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvf_ig.calibration.refusal import RejectedFrame, Rejection
from dvf_ig.core import (
    FloatArray,
    IntArray,
    InvalidInputError,
    NWirePhantom,
    NWireRecording,
    PoseStream,
    Progress,
    QualityGateError,
    TrackedSequence,
    read_only_arrays,
    untold,
)

from .dots import MOST_DOTS, Clip, Dots, find_dots
from .lines import USUAL_TOLERANCES, Tolerances
from .pattern import FoundWires, find_wires
from .plan import WirePlan, plan_wires

SCALE_FRAMES = 10
"""Frames from which the pixel size is estimated."""
SCALE_STEP = 1.25
"""Ratio between successive pixel sizes tried if none is given."""
SCALE_SHARE = 0.08
"""Share by which the apparent pixel size of frames may differ: the foreshortening of a tilt."""


@dataclass(frozen=True, slots=True)
class WireImageOptions:
    """Region, scale and criteria of the search for wires.

    Attributes:
        spacing_mm: approximate pixel size; None tries many.
        clip: the part of the images that shows ultrasound; None takes all.
        most: dots kept in each image, the strongest first.
        tolerances: how closely dots must match the phantom's wires.
    """

    spacing_mm: float | None = None
    clip: Clip | None = None
    most: int = MOST_DOTS
    tolerances: Tolerances = USUAL_TOLERANCES


@dataclass(frozen=True, slots=True, eq=False)
class WireFrame:
    """Detections in one frame: candidate dots, and the wires among them or why there are none."""

    dots: Dots
    wires: FoundWires | RejectedFrame

    @property
    def found(self) -> FoundWires | None:
        return self.wires if isinstance(self.wires, FoundWires) else None

    @property
    def rejected(self) -> RejectedFrame | None:
        return self.wires if isinstance(self.wires, RejectedFrame) else None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WireSegmentation:
    """Wires found in a recording.

    Attributes:
        spacing_mm: pixel size estimated from the phantom's, along the larger side of the pixel.
        frames: one for each image.
        points_px: (n, wires, 2) column, row in the phantom's order; NaN if a frame was left out.
    """

    spacing_mm: float
    frames: tuple[WireFrame, ...]
    points_px: FloatArray

    @property
    def used(self) -> int:
        """Number of frames whose wires were found."""
        return int(np.isfinite(self.points_px).all(axis=(1, 2)).sum())

    @property
    def reasons(self) -> dict[str, int]:
        """Number of frames left out by reason, the most frequent first."""
        return dict(Counter(f.rejected.reason.value for f in self.frames if f.rejected).most_common())


def segment_wires(
    sequence: TrackedSequence,
    phantom: NWirePhantom,
    *,
    options: WireImageOptions | None = None,
    progress: Progress = untold,
) -> WireSegmentation:
    """Find the wires of an N-wire phantom in every image of a sequence.

    Args:
        sequence: with images; its orientation separates left from right if the phantom's outer wires do not.
        phantom: two or more N patterns.
        progress: called with the fraction of images done.
    Raises:
        InvalidInputError: no images, a phantom that gives no plan, or a clip outside the images.
        QualityGateError: the pixel size is not given, and no frame shows the phantom at any.
    """
    options = options or WireImageOptions()
    if sequence.images is None:
        raise InvalidInputError("the sequence records poses alone; needed images of the N-wire phantom")
    plan = plan_wires(phantom, sequence.orientation)
    images, valid = sequence.images, sequence.image_valid
    spacing = _spacing(images, np.flatnonzero(valid), plan, options)
    if spacing is None:
        spacing = _given_spacing(options)
    else:
        options = replace(options, tolerances=replace(options.tolerances, scale_share=SCALE_SHARE))
    frames = []
    for i in range(len(images)):
        frames.append(_frame(images[i], bool(valid[i]), plan, spacing, options))
        progress((i + 1) / len(images))
    missing = np.full((3 * len(phantom.patterns), 2), np.nan)
    points = [missing if f.found is None else f.found.points_px for f in frames]
    return WireSegmentation(spacing, tuple(frames), np.stack(points))


def recording_of(
    segmentation: WireSegmentation, phantom: NWirePhantom, phantom_from_probe: PoseStream
) -> NWireRecording:
    """Combine the segmented wires with the poses of the same frames.

    Raises:
        QualityGateError: no frame shows all wires.
    """
    if segmentation.used == 0:
        listed = ", ".join(f"{count} {reason}" for reason, count in segmentation.reasons.items())
        raise QualityGateError(
            f"none of {len(segmentation.frames)} images shows all {len(phantom.wires)} wires ({listed}); "
            "check gain and depth, the phantom's geometry, and the approximate pixel size"
        )
    return NWireRecording(phantom, phantom_from_probe, segmentation.points_px)


def _spacing(
    images: NDArray[np.uint8], valid: IntArray, plan: WirePlan, options: WireImageOptions
) -> float | None:
    """Estimate the pixel size in mm from the phantom in a few valid frames; None if none shows it.

    Chooses the size at which most frames show the phantom, then the one with the least misfit.
    """
    sampled = (
        valid[np.unique(np.linspace(0, len(valid) - 1, SCALE_FRAMES).astype(int))] if len(valid) else valid
    )
    best, best_score = None, (0, -np.inf)
    for size in _sizes(images.shape[2], plan, options):
        tried = [_frame(images[i], True, plan, size, options).wires for i in sampled.tolist()]
        matches = [wires for wires in tried if isinstance(wires, FoundWires)]
        if matches:
            score = (len(matches), -float(np.median([wires.misfit_mm for wires in matches])))
            if score > best_score:
                best, best_score = size * float(np.median([wires.scale for wires in matches])), score
    return best


def _given_spacing(options: WireImageOptions) -> float:
    if options.spacing_mm is None:
        raise QualityGateError(
            f"none of {SCALE_FRAMES} images shows the phantom at any pixel size; check gain, depth and the "
            "phantom's geometry, or give ApproximateSpacingMmPerPixel in the device set's <Segmentation>"
        )
    return options.spacing_mm


def _sizes(columns: int, plan: WirePlan, options: WireImageOptions) -> list[float]:
    """List the given pixel size, or those at which the phantom spans all to a twelfth of the image width."""
    if options.spacing_mm is not None:
        return [options.spacing_mm]
    width_px = columns if options.clip is None else options.clip[2]
    smallest = float(np.ptp(plan.outer_mm[..., 0])) / width_px
    return [smallest * SCALE_STEP**k for k in range(1 + int(np.log(12) / np.log(SCALE_STEP)))]


def _frame(
    image: NDArray[np.uint8], valid: bool, plan: WirePlan, spacing_mm: float, options: WireImageOptions
) -> WireFrame:
    if not valid:
        none = Dots(np.zeros((0, 2)), np.zeros(0))
        return WireFrame(
            none, RejectedFrame(Rejection.IMAGE_INVALID, "the recorder marked the image invalid")
        )
    dots = find_dots(image, spacing_mm, clip=options.clip, most=options.most)
    return WireFrame(dots, find_wires(dots, plan, spacing_mm, options.tolerances))
