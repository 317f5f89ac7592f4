"""Any rigid pair of 3-D images, the fixed one ultrasound: the same search on planes of the fixed volume.

Images need not be of hearts: the pitch follows the size of what was insonified, and whether the pose may be
used is judged as `pair_check` says.
"""

from collections.abc import Callable
from time import perf_counter

import numpy as np

from dvf_ig.core import FloatArray, NoOverlapError, Rigid, Volume
from dvf_ig.registration.evidence.pair_check import doubt_about, judged
from dvf_ig.registration.lc2.channels import channels_from_still

from .pair_images import FanVolume, anatomy_around, extent_mm, fan_volume, share_inside, usable_voxels
from .pose_chart import HEART_RADIUS_MM
from .rigid import Level, RegistrationOptions, RegistrationResult, register_rigid

PITCHES = 80.0
"""Fine pitches along the longest edge of the fan; not finer than the ultrasound's voxels."""
REACH_MM = 30.0
"""How far a pose may move from the start, and how much of the anatomy around the fan is kept."""
MIN_START_OVERLAP = 0.1


def register_pair(
    fixed: Volume,
    moving: Volume,
    start: Rigid,
    *,
    rng: np.random.Generator,
    mask: Volume | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """moving_from_fixed of an ultrasound volume (fixed) and an MR or CT volume (moving).

    Args:
        fixed: ultrasound; zeros around the lit voxels count as not insonified, dark gaps among them as dark.
        moving: anatomy with intensities.
        start: moving_from_fixed to start from.
        mask: on the fixed image's grid, non-zero where it may be used.
    Returns:
        the pose with its evidence; see `pair_check` for what makes it unusable besides.
    Raises:
        InvalidInputError: an empty image, or a mask on another grid.
        NoOverlapError: the images do not overlap at the start.
    """
    began, tell = perf_counter(), progress or (lambda _: None)
    usable = usable_voxels(fixed, mask)
    fine_mm = max(float(fixed.grid.spacing_mm.min()), extent_mm(fixed, usable) / PITCHES)
    fine, coarse = (fan_volume(fixed, usable, pitch) for pitch in (fine_mm, 2.0 * fine_mm))
    _require_overlap(moving, fine, start)
    # distances between poses are taken at the heart's radius, where turns of a smaller organ look longer
    longer = max(1.0, HEART_RADIUS_MM / fine.radius_mm)
    options = RegistrationOptions(patch_mm=9.0 * fine_mm, bound_mm=REACH_MM * longer)
    levels = [_level(fan, moving, start) for fan in (coarse, fine)]
    center: FloatArray = start.apply_array(fine.points_mm(5000).mean(axis=0))
    result = register_rigid(
        levels[0], levels[1], start, center, rng=rng, options=options, progress=lambda x: tell(0.7 * x)
    )
    doubt = doubt_about(result, fine, levels[0], levels[1], options.patch_mm, rng)
    tell(1.0)
    return judged(result, doubt, perf_counter() - began)


def _level(fan: FanVolume, moving: Volume, start: Rigid) -> Level:
    anatomy = anatomy_around(moving, fan, start, REACH_MM)
    return Level(fan.slices(), channels_from_still(anatomy, smoothing_mm=fan.pitch_mm / 1.5), fan.pitch_mm)


def _require_overlap(moving: Volume, fan: FanVolume, start: Rigid) -> None:
    share = share_inside(moving, fan, start)
    if share < MIN_START_OVERLAP:
        raise NoOverlapError(
            f"{100 * share:.0f} % of the ultrasound lies inside the moving image at the start pose, needed "
            f"{100 * MIN_START_OVERLAP:.0f} %; give a start with --init FILE.tfm (without one the images are "
            "taken to share one world frame)"
        )
