"""Volume of a cavity over the cycle, from its labels at end-diastole and the estimated motion."""

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError

from .cycle import CycleMotion
from .free_form import volume_ratio


def cavity_volumes_mm3(motion: CycleMotion, cavity: BoolArray) -> FloatArray:
    """Compute (n,) volumes of the cavity by phase: ∫ det(∂x/∂X) dV over its voxels at end-diastole.

    Args:
        cavity: (nx, ny, nz) voxels of the cavity at end-diastole, on the 4-D image's grid.
    Raises:
        InvalidInputError: a cavity without voxels.
    """
    inside = np.asarray(motion.cropped(cavity))
    if not inside.any():
        raise InvalidInputError("the cavity has no voxels at end-diastole; check the label values")
    voxel_mm3 = float(np.prod(motion.grid.spacing_mm))
    spacing = motion.grid.spacing_mm
    ratios = [volume_ratio(d.on_voxels(), spacing, inside) for d in motion.deformations]
    return np.array([voxel_mm3 * float(ratio.sum()) for ratio in ratios])
