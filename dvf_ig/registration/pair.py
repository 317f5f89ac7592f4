"""Any rigid pair of 3-D images, one of them ultrasound: the same search on planes of the ultrasound volume.

Images need not be of hearts: the pitch follows the size of what was insonified, and whether the pose may be
used is judged as `pair_check` says. The source is the ultrasound, the target the anatomy: where a user calls
them "fixed" and "moving", the result is moving_from_fixed.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, NoOverlapError, Rigid, Volume
from dvf_ig.registration.lc2.channels import channels_from_still

from .data import Level, RegistrationData, RegistrationOptions
from .pair_check import apply_pair_check, pair_statistic
from .pair_images import FanVolume, anatomy_around, extent_mm, fan_volume, share_inside, usable_voxels
from .result import RegistrationResult
from .rigid import register_rigid

PITCHES = 80.0
"""Fine pitches along the longest edge of the fan; not finer than the ultrasound's voxels."""
REACH_MM = 30.0
"""How far a pose may move from the start, and how much of the anatomy around the fan is kept."""
MIN_START_OVERLAP = 0.1


def register_pair(
    ultrasound: Volume,
    anatomy: Volume,
    start: Rigid,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    mask: Volume | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register an ultrasound volume to an MR or CT volume.

    Args:
        ultrasound: zeros around the non-zero voxels count as not insonified, dark gaps among them as dark.
        anatomy: MR or CT intensities.
        start: anatomy_from_ultrasound to start from.
        clock: seconds from any origin, for the result's `seconds`.
        mask: on the ultrasound's grid, non-zero where it may be used.
    Returns:
        the pose with its evidence; see `pair_check` for what makes it unusable besides.
    Raises:
        InvalidInputError: an empty image, or a mask on another grid.
        NoOverlapError: the images do not overlap at the start.
    """
    began, report_progress = clock(), progress or (lambda _: None)
    usable = usable_voxels(ultrasound, mask)
    fine_mm = max(float(ultrasound.grid.spacing_mm.min()), extent_mm(ultrasound, usable) / PITCHES)
    fine, coarse = (fan_volume(ultrasound, usable, pitch) for pitch in (fine_mm, 2.0 * fine_mm))
    _require_overlap(anatomy, fine, start)
    # distances between poses are taken at the heart's radius, where turns of a smaller organ look longer
    longer = max(1.0, HEART_RADIUS_MM / fine.radius_mm)
    options = RegistrationOptions(patch_mm=9.0 * fine_mm, bound_mm=REACH_MM * longer)
    center: FloatArray = start.apply_array(fine.points_mm(5000).mean(axis=0))
    data = RegistrationData(_level(coarse, anatomy, start), _level(fine, anatomy, start), center)
    result = register_rigid(
        data, start, rng=rng, clock=clock, options=options, progress=lambda x: report_progress(0.7 * x)
    )
    statistic = pair_statistic(result, fine, data.coarse, data.fine, options=options, rng=rng)
    report_progress(1.0)
    return replace(apply_pair_check(result, statistic), seconds=clock() - began)


def _level(fan: FanVolume, anatomy: Volume, start: Rigid) -> Level:
    part = anatomy_around(anatomy, fan, start, REACH_MM)
    return Level(fan.slices(), channels_from_still(part, smoothing_mm=fan.pitch_mm / 1.5), fan.pitch_mm)


def _require_overlap(anatomy: Volume, fan: FanVolume, start: Rigid) -> None:
    share = share_inside(anatomy, fan, start)
    if share < MIN_START_OVERLAP:
        raise NoOverlapError(
            f"{100 * share:.0f} % of the ultrasound lies inside the moving image at the start pose, needed "
            f"{100 * MIN_START_OVERLAP:.0f} %; give a start with --init FILE.tfm (without one the images are "
            "taken to share one world frame)"
        )
