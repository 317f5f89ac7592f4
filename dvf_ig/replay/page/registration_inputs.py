"""Inputs of a registration as its page shows them: gated frames, gated volumes, a pair of images."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    FloatArray,
    Grid,
    Rigid,
    Scenario,
    TrackedVolume,
    Volume,
    VolumeSeries,
)
from dvf_ig.registration import RegistrationResult
from dvf_ig.report.plane_marks import viewed_upright
from dvf_ig.report.plane_overlay import PlaneOverlay
from dvf_ig.session import GatedFrames, Heart, UltrasoundRecording

from .planes import Anatomy, anatomy_of_heart, anatomy_of_image, frame_overlays, plane_overlay
from .registration_page import ShownInput

PIXELS = 256
"""Approximate pixels along the longer edge of a plane; not finer than a third of a voxel."""
MOST_VOLUMES = 2
BRIGHT_PERCENT = 99.5
AXES = ("first", "second", "third")


def tracked_overlays(
    anatomy: Anatomy, volumes: Sequence[TrackedVolume], start: Rigid, registered: Rigid
) -> list[PlaneOverlay]:
    """Overlay three planes of each of up to MOST_VOLUMES volumes, evenly spread over those given.

    Args:
        start, registered: poses from the volumes' common frame.
    """
    chosen = sorted({round(i) for i in np.linspace(0, len(volumes) - 1, MOST_VOLUMES)})
    overlays = []
    for i in chosen:
        volume = volumes[i]
        pose = volume.tracker_from_image
        seen = volume.mask.values != 0
        overlays += _three_planes(
            anatomy,
            volume.image.grid,
            np.where(seen, volume.image.values, 0).astype(np.uint8),
            seen,
            start @ pose,
            registered @ pose,
            name=f"volume {i + 1}",
            event_s=volume.t_s or None,
            model_phase=volume.model_phase,
        )
    return overlays


def image_overlays(
    anatomy: Anatomy, ultrasound: Volume, start: Rigid, registered: Rigid
) -> list[PlaneOverlay]:
    """Overlay three planes of an ultrasound image of an organ that does not beat."""
    grey = shown_grey(ultrasound.values)
    return _three_planes(anatomy, ultrasound.grid, grey, grey > 0, start, registered, name="fixed image")


def shown_grey(values: AnyArray) -> NDArray[np.uint8]:
    """Scale grey levels to 0 to 255; 0 and NaN stay black."""
    usable = np.isfinite(values) & (values != 0)
    if not usable.any():
        return np.zeros(values.shape, dtype=np.uint8)
    low = min(0.0, float(values[usable].min()))
    high = float(np.percentile(values[usable], BRIGHT_PERCENT))
    level = 1.0 + 254.0 * (np.where(usable, values, low) - low) / max(high - low, 1e-12)
    return np.where(usable, np.clip(level, 1.0, 255.0), 0.0).astype(np.uint8)


def _three_planes(
    anatomy: Anatomy,
    grid: Grid,
    grey: NDArray[np.uint8],
    seen: BoolArray,
    start: Rigid,
    registered: Rigid,
    *,
    name: str,
    event_s: float | None = None,
    model_phase: float | None = None,
) -> list[PlaneOverlay]:
    """Cut planes across each axis of the grid, through the middle of the insonified part."""
    middle = ndimage.center_of_mass(seen) if seen.any() else (np.array(grid.shape) - 1.0) / 2
    overlays = []
    for axis in range(3):
        index_from_pixel = _upright(grid, axis, np.asarray(middle), registered.rotation)
        image, index_from_pixel = _resampled(grid, grey, index_from_pixel)
        frame_from_pixel = grid.axes_mm @ index_from_pixel
        frame_from_pixel[:, 2] += grid.origin_mm
        overlays.append(
            plane_overlay(
                anatomy,
                start,
                registered,
                image,
                frame_from_pixel,
                name=f"{name}, across its {AXES[axis]} axis",
                event_s=event_s,
                model_phase=model_phase,
            )
        )
    return overlays


def _upright(grid: Grid, axis: int, middle: FloatArray, rotation: FloatArray) -> FloatArray:
    """Compute (3, 3) voxel indices from (column, row, 1) counted in voxels, upright in the patient."""
    plane_axes = [a for a in range(3) if a != axis]
    column, row, left, up = viewed_upright((rotation @ grid.direction)[:, plane_axes].T)
    out = np.zeros((3, 3))
    out[axis, 2] = middle[axis]
    for k, (a, reversed_) in enumerate(((plane_axes[column], left), (plane_axes[row], up))):
        out[a, k] = -1.0 if reversed_ else 1.0
        out[a, 2] = grid.shape[a] - 1.0 if reversed_ else 0.0
    return out


def _resampled(
    grid: Grid, grey: NDArray[np.uint8], index_from_voxel: FloatArray
) -> tuple[NDArray[np.uint8], FloatArray]:
    """Resample the plane at square pixels; also return their map to voxel indices."""
    steps = [int(np.abs(index_from_voxel[:, k]).argmax()) for k in range(2)]
    mm = grid.spacing_mm[steps]
    count = np.array([grid.shape[a] for a in steps])
    pixel_mm = max(float((mm * (count - 1)).max()) / PIXELS, float(mm.min()) / 3)
    columns, rows = (np.floor((count - 1) * mm / pixel_mm).astype(int) + 1).tolist()
    index_from_pixel = index_from_voxel @ np.diag([pixel_mm / mm[0], pixel_mm / mm[1], 1.0])
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    pixels = np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    level = ndimage.map_coordinates(grey, index_from_pixel @ pixels, order=1, output=np.float64)
    return np.rint(level).reshape(rows, columns).astype(np.uint8), index_from_pixel


TRACKER, PREOPERATIVE = "the tracker", "the pre-operative image"


def frames_shown(
    result: RegistrationResult, frames: GatedFrames, recording: UltrasoundRecording, scenario: Scenario
) -> ShownInput:
    """Show the gated, tracked frames of a scenario."""
    heart, mr, name = recording.heart, scenario.preop.mr, scenario.name
    anatomy = anatomy_of_heart(heart, mr)
    gated = frames.gated
    return ShownInput(
        title=f"Registration of {name}",
        about=f"patient {heart.model.patient_id}",
        source_name=TRACKER,
        target_name=PREOPERATIVE,
        anatomy=anatomy.name,
        remark=anatomy.remark,
        planes=frame_overlays(
            frames,
            recording.images,
            recording.calibrations.probe_from_image,
            anatomy,
            result.start,
            result.target_from_source,
        ),
        data=[
            ("frames recorded", str(len(frames.event_s))),
            (
                "frames compared with the model",
                f"{len(frames.used)} of {len(gated.index)} that passed the gate",
            ),
            *((f"rejected: {reason}", str(count)) for reason, count in gated.rejected.items() if count),
            ("seen", f"{frames.event_s[frames.used[0]]:.1f} to {frames.event_s[frames.used[-1]]:.1f} s"),
            ("R peaks found", str(len(recording.peaks))),
            *_model_rows(heart),
        ],
        frames=len(frames.used),
        model=heart.model,
        frames_rejected={str(reason): count for reason, count in gated.rejected.items() if count},
        targets=scenario.landmarks_mr,
        tracked_against=scenario.tracked_against,
    )


def volumes_shown(
    result: RegistrationResult,
    volumes: Sequence[TrackedVolume],
    heart: Heart,
    mr: VolumeSeries | None,
    *,
    about: str = "",
) -> ShownInput:
    """Show gated 3-D volumes.

    Args:
        volumes: as they were registered.
        mr: pre-operative grey levels; None without any.
        about: from which files.
    """
    anatomy = anatomy_of_heart(heart, mr)
    phases = ", ".join(f"{100 * volume.model_phase:.0f} %" for volume in volumes)
    whose = f"patient {heart.model.patient_id}"
    return ShownInput(
        title="Registration of gated 3-D ultrasound",
        about=f"{whose}, {about}" if about else whose,
        source_name=TRACKER if result.target_from_source.source == "tracker" else "the ultrasound volumes",
        target_name=PREOPERATIVE,
        anatomy=anatomy.name,
        remark=anatomy.remark,
        planes=tracked_overlays(anatomy, volumes, result.start, result.target_from_source),
        data=[("volumes", str(len(volumes))), ("places in the cycle", phases), *_model_rows(heart)],
        model=heart.model,
    )


def pair_shown(result: RegistrationResult, ultrasound: Volume, anatomy: Volume, *, about: str) -> ShownInput:
    """Show a pair of images.

    Args:
        about: the files they come from.
    """
    return ShownInput(
        title="Registration of an image pair",
        about=about,
        source_name="the fixed image",
        target_name="the moving image",
        anatomy="moving image",
        remark="",
        planes=image_overlays(
            anatomy_of_image(anatomy, "moving image"), ultrasound, result.start, result.target_from_source
        ),
        data=[
            (f"{name} image", _size(image)) for name, image in (("fixed", ultrasound), ("moving", anatomy))
        ],
    )


def _model_rows(heart: Heart) -> list[tuple[str, str]]:
    model = heart.model
    return [("model", f"surface {model.surface_name}, {model.phases} phases")]


def _size(image: Volume) -> str:
    voxels, spacing = image.grid.shape, image.grid.spacing_mm
    return f"{' × '.join(map(str, voxels))} voxels of {' × '.join(f'{v:.2f}' for v in spacing)} mm"
