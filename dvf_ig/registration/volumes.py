"""Registration of gated 3-D ultrasound: planes of every volume, with place and phase."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError, Rigid, TrackedVolume, read_only_arrays
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.kernels.grid.pool import pool_blocks, pool_cubes
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.points import boundary_points
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.evidence.checks import VOLUME_LIMITS
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.slices import SliceSet, joined, slices_of_volume

from .data import Level, RegistrationData, RegistrationOptions
from .result import RegistrationResult
from .rigid import register_rigid
from .start import LandmarkPrior

VOLUME_SMOOTHING_MM = 3.0
"""Of the model's channels. Tuning seeds 101–106, two views, three phases: median TRE 0.74 mm; 0.83 with 2.5
or 3.5 mm, and 0.83 on 2 mm voxels."""
COARSE_PITCH_MM, COARSE_PLANES = 4.0, 6
"""Pixels of the coarse planes, and about how many of these along each axis."""
FINE_PITCH_MM, FINE_PLANES = 3.0, 13
"""The same of the fine planes."""
BOUNDARY_PITCH_MM, BOUNDARY_PLANES = 2.0, 8
"""The same of those on which the boundary is found."""
CUBE_TOLERANCE = 1e-3
"""Relative difference of voxel edges up to which voxels count as cubes of one size."""
SEARCH = RegistrationOptions(
    starts=8,
    spread_mm=12.0,
    candidates=2,
    times_seen=3,
    bound_mm=120.0,
    limits=VOLUME_LIMITS,
)
"""Of gated volumes:"""
GREY_VOLUMES = "volumes"
"""Kind of images for the calibration of evidence: gated volumes against smoothed grey levels of MR."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class VolumeTarget:
    """What gated volumes are registered to.

    Attributes:
        channels: by which LC2 explains the ultrasound; of MR, smoothed by VOLUME_SMOOTHING_MM.
        center_mm: (3,) centre of the heart box, in the channels' frame.
        surface: the model's surface at the phases in use, where its labels are known.
        kind: GREY_VOLUMES, where channels are that; None: no probability and no bound is stated.
    """

    channels: ModelChannels
    center_mm: FloatArray
    surface: BoundaryTarget | None = None
    kind: str | None = None


def register_volumes(
    volumes: Sequence[TrackedVolume],
    target: VolumeTarget,
    start: Rigid,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    prior: LandmarkPrior | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register gated 3-D images to the phase-matched model from a coarse pose.

    Args:
        volumes: any number of views and phases.
        start: target_from_source.
        clock: seconds from any origin, for the result's `seconds`.
        prior: touched landmarks that the pose must also agree with.
        progress: is told the share of the work that is done.
    Returns:
        as `register_rigid`; `seconds` counts the preparation of the volumes.
    Raises:
        InvalidInputError: no volume, or nothing insonified.
    """
    began = clock()
    with ThreadPoolExecutor(thread_count()) as pool:
        seen = pool.submit(_boundary, volumes, target)
        coarse, fine = pool.map(
            lambda sizes: _level(volumes, target, *sizes),
            ((COARSE_PITCH_MM, COARSE_PLANES), (FINE_PITCH_MM, FINE_PLANES)),
        )
        boundary = seen.result()
    data = RegistrationData(coarse, fine, target.center_mm, boundary, prior)
    options = replace(SEARCH, kind=target.kind)
    result = register_rigid(data, start, rng=rng, clock=clock, options=options, progress=progress)
    return replace(result, seconds=clock() - began)


def _level(volumes: Sequence[TrackedVolume], target: VolumeTarget, pitch_mm: float, planes: int) -> Level:
    return Level(prepare_volumes(volumes, pitch_mm=pitch_mm, planes=planes), target.channels, pitch_mm)


def _boundary(volumes: Sequence[TrackedVolume], target: VolumeTarget) -> Boundary | None:
    """What the volumes show of the model's surface, where that is known."""
    if target.surface is None:
        return None
    slices = prepare_volumes(volumes, pitch_mm=BOUNDARY_PITCH_MM, planes=BOUNDARY_PLANES)
    return Boundary(boundary_points(slices), target.surface)


def prepare_volumes(volumes: Sequence[TrackedVolume], *, pitch_mm: float, planes: int) -> SliceSet:
    """Average grey levels, as shown, down to about `pitch_mm` and take planes of each along its three axes.

    Where all voxels are cubes of one size, the nearest whole number of them is averaged; others, and volumes
    that differ, are averaged over cubes of `pitch_mm`, each voxel by its share inside the cube.

    Args:
        volumes: of one transducer, at any number of phases; they share one unknown pose.
        pitch_mm: wanted.
        planes: about this many along each axis.
    Raises:
        InvalidInputError: no volume, or nothing insonified.
    """
    if not volumes:
        raise InvalidInputError("no ultrasound volume passed the gate; needed at least one")
    edges = np.array([volume.image.grid.spacing_mm for volume in volumes])
    if np.ptp(edges) > CUBE_TOLERANCE * edges.max():
        return joined([_planes(volume, _cubes(volume, pitch_mm, planes)) for volume in volumes])
    return joined([_planes(volume, _blocks(volume, pitch_mm, planes)) for volume in volumes])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Averaged:
    """Grey levels averaged over blocks of `edge` voxels, NaN where one of them was not insonified.

    Filled in on every `every`-th plane along each axis (`kernels.grid.pool.on_a_plane`).
    """

    values: NDArray[np.float32]
    edge: FloatArray
    every: int


def _blocks(volume: TrackedVolume, pitch_mm: float, planes: int) -> _Averaged:
    """Over the nearest whole number of voxels, which are cubes."""
    grid = volume.image.grid
    step = max(1, round(pitch_mm / float(grid.spacing_mm[0])))
    small: NDArray[np.float32] = np.empty([n // step for n in grid.shape], dtype=np.float32)
    every = _every(small, planes)
    pool_blocks(volume.image.values, _insonified(volume), step, every, small)
    return _Averaged(small, np.full(3, float(step)), every)


def _cubes(volume: TrackedVolume, pitch_mm: float, planes: int) -> _Averaged:
    """Over cubes of exactly `pitch_mm`."""
    grid = volume.image.grid
    edge = pitch_mm / grid.spacing_mm
    counts = [int(n / e + 1e-9) for n, e in zip(grid.shape, edge, strict=True)]  # 6 · 0.1 is 0.6
    small: NDArray[np.float32] = np.empty(counts, dtype=np.float32)
    every = _every(small, planes)
    pool_cubes(volume.image.values, _insonified(volume), edge, every, small)
    return _Averaged(small, edge, every)


def _every(small: NDArray[np.float32], planes: int) -> int:
    return max(1, int(max(small.shape)) // planes)


def _insonified(volume: TrackedVolume) -> NDArray[np.uint8]:
    """Of any type; 8 bits are looked at as they are."""
    values = volume.mask.values
    return values.view(np.uint8) if values.dtype.itemsize == 1 else np.asarray(values != 0, dtype=np.uint8)


def _planes(volume: TrackedVolume, averaged: _Averaged) -> SliceSet:
    grid, pose = volume.image.grid, volume.tracker_from_image
    return slices_of_volume(
        averaged.values,
        pose.rotation @ (grid.axes_mm * averaged.edge),
        pose.apply_array(grid.to_mm((averaged.edge - 1.0) / 2)),
        every=averaged.every,
        frame=pose.target,
        model_phase=volume.model_phase,
        t_s=volume.t_s,
    )
