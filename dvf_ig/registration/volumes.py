"""Registration of gated 3-D ultrasound: planes of every volume, with place and phase."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError, Rigid, TrackedVolume
from dvf_ig.kernels.pool import pool_blocks
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.points import boundary_points
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.evidence.checks import VOLUME_LIMITS
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.slices import SliceSet, grey_to_root_amplitude, joined, slices_of_volume

from .data import Level, RegistrationData, RegistrationOptions
from .result import RegistrationResult
from .rigid import register_rigid
from .start import LandmarkPrior

VOLUME_SMOOTHING_MM = 3.0
"""Of the model's channels. Tuning seeds 101–106, two views, three phases: median TRE 0.74 mm; 0.83 with 2.5
or 3.5 mm, and 0.83 on 2 mm voxels."""
COARSE_PITCH_MM, COARSE_PLANES = 4.0, 6
FINE_PITCH_MM, FINE_PLANES = 3.0, 13
BOUNDARY_PITCH_MM, BOUNDARY_PLANES = 2.0, 8
SEARCH = RegistrationOptions(
    starts=8, spread_mm=12.0, candidates=2, bound_mm=120.0, limits=VOLUME_LIMITS, half_volumes=True
)


def register_volumes(
    volumes: Sequence[TrackedVolume],
    model: ModelChannels,
    start: Rigid,
    center_mm: FloatArray,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    prior: LandmarkPrior | None = None,
    surface: BoundaryTarget | None = None,
) -> RegistrationResult:
    """Register gated 3-D images to the phase-matched model from a coarse pose.

    Args:
        volumes: any number of views and phases.
        model: channels smoothed by VOLUME_SMOOTHING_MM.
        start: target_from_source; center_mm: (3,) centre of the heart box, target frame.
        clock: seconds from any origin, for the result's `seconds`.
        prior: touched landmarks that the pose must also agree with.
        surface: the model's surface at the phases in use, where its labels are known.
    Returns:
        as `register_rigid`; `seconds` counts the preparation of the volumes.
    """
    began = clock()
    coarse, fine = (
        Level(prepare_volumes(volumes, pitch_mm=pitch, planes=planes), model, pitch)
        for pitch, planes in ((COARSE_PITCH_MM, COARSE_PLANES), (FINE_PITCH_MM, FINE_PLANES))
    )
    boundary = None
    if surface is not None:
        slices = prepare_volumes(volumes, pitch_mm=BOUNDARY_PITCH_MM, planes=BOUNDARY_PLANES)
        boundary = Boundary(boundary_points(slices), surface)
    data = RegistrationData(coarse, fine, center_mm, boundary, prior)
    result = register_rigid(data, start, rng=rng, clock=clock, options=SEARCH)
    return replace(result, seconds=clock() - began)


def prepare_volumes(volumes: Sequence[TrackedVolume], *, pitch_mm: float, planes: int) -> SliceSet:
    """Average volumes down to about `pitch_mm` and take planes of each along its three axes.

    Args:
        volumes: of one transducer, at any number of phases; they share one unknown pose.
        pitch_mm: wanted; the nearest whole number of voxels is averaged.
        planes: about this many along each axis.
    Raises:
        InvalidInputError: no volume, or one with unequal voxels, or nothing insonified.
    """
    if not volumes:
        raise InvalidInputError("no ultrasound volume passed the gate; needed at least one")
    return joined([_planes(volume, pitch_mm, planes) for volume in volumes])


def _planes(volume: TrackedVolume, pitch_mm: float, planes: int) -> SliceSet:
    grid = volume.image.grid
    if np.ptp(grid.spacing_mm) > 1e-3 * grid.spacing_mm.max():
        raise InvalidInputError(
            f"the ultrasound volume's voxels are {grid.spacing_mm.tolist()} mm; resample it to equal edges"
        )
    step = max(1, round(pitch_mm / float(grid.spacing_mm[0])))
    small: NDArray[np.float32] = np.empty([n // step for n in grid.shape], dtype=np.float32)
    mask = np.asarray(volume.mask.values != 0, dtype=np.uint8)
    pool_blocks(volume.image.values, mask, grey_to_root_amplitude(), step, small)
    pose = volume.tracker_from_image
    first = grid.to_mm(np.full(3, (step - 1) / 2))
    return slices_of_volume(
        small,
        pose.rotation @ (grid.axes_mm * step),
        pose.apply_array(first),
        every=max(1, max(small.shape) // planes),
        frame=pose.target,
        model_phase=volume.model_phase,
        t_s=volume.t_s,
    )
