"""Connected components of a mask."""

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray


def largest_component(mask: BoolArray) -> BoolArray:
    """Return the largest connected component of a mask (voxels that share faces), with its holes filled."""
    components, count = ndimage.label(mask)
    if count > 1:
        mask = np.asarray(components == 1 + int(np.argmax(np.bincount(components.ravel())[1:])))
    return np.asarray(ndimage.binary_fill_holes(mask))
