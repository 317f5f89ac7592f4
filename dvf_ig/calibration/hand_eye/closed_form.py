"""Closed-form hand–eye solutions of OpenCV, which start the fit; cv2 is loaded when one is computed.

Source: Tsai & Lenz 1989, Park & Martin 1994, Horaud & Dornaika 1995, Andreff 1999, Daniilidis 1999; with the
target's pose in the base as a second unknown, Shah 2013 and Li 2010.
"""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.space.rigid import nearest_rotation

from .fit import Chain

HandEyeMethod = Literal["tsai", "park", "horaud", "andreff", "daniilidis", "shah", "li"]
HAND_EYE_METHODS: tuple[HandEyeMethod, ...] = get_args(HandEyeMethod)

_ROBOT_WORLD = ("shah", "li")


def closed_form(method: HandEyeMethod) -> Callable[[Chain], FloatArray]:
    """Return the function from a chain to (4, 4) hand_from_camera; it gives NaN if OpenCV finds none."""
    if method not in HAND_EYE_METHODS:
        raise InvalidInputError(f"hand-eye method '{method}' is not one of {', '.join(HAND_EYE_METHODS)}")

    def solve(chain: Chain) -> FloatArray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = _opencv(chain, method)
        if not np.isfinite(out).all() or np.linalg.det(out[:3, :3]) <= 0:
            return np.full((4, 4), np.nan)
        out[:3, :3] = nearest_rotation(out[:3, :3])
        return out

    return solve


def _opencv(chain: Chain, method: HandEyeMethod) -> tuple[FloatArray, FloatArray]:
    """Compute rotation and translation of hand_from_camera; NaN if OpenCV refuses a degenerate sample."""
    import cv2

    hand = (list(chain.hand_rotations), list(chain.hand_translations))
    target = (list(chain.target_rotations), list(chain.target_translations))
    try:
        if method not in _ROBOT_WORLD:
            kind = getattr(cv2, f"CALIB_HAND_EYE_{method.upper()}")
            rotation, shift = cv2.calibrateHandEye(*hand, *target, method=kind)
            return np.asarray(rotation), np.ravel(shift)
        inverse = np.swapaxes(chain.hand_rotations, 1, 2)
        shifted = -np.einsum("nij,nj->ni", inverse, chain.hand_translations)
        kind = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}")
        solution = cv2.calibrateRobotWorldHandEye(*target, list(inverse), list(shifted), method=kind)
    except cv2.error:
        return np.full((3, 3), np.nan), np.full(3, np.nan)
    hand_from_camera = np.asarray(solution[2]).T
    return hand_from_camera, -hand_from_camera @ np.ravel(solution[3])
