"""Names of coordinate frames.

A frame is a lower-case identifier: "mr", "tracker", "probe", "tool", "tool_tip", "image", "phantom".
Transforms are named target_from_source, so adjacent names cancel:
`mr_from_probe = mr_from_tracker @ tracker_from_probe`.
"""

import re

import numpy as np

from dvf_ig.core.arrays import frozen_floats
from dvf_ig.core.errors import FrameMismatchError, InvalidInputError

RAS_FROM_LPS = frozen_floats(np.diag([-1.0, -1.0, 1.0, 1.0]), "RAS from LPS", (4, 4))
"""Coordinates of PLUS and 3D Slicer from ours and ITK's; its own inverse."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")


def check_frame(name: str) -> str:
    """Return `name` if it is a legal frame name, else raise InvalidInputError."""
    if not _NAME.fullmatch(name):
        raise InvalidInputError(
            f"'{name}' is not a frame name; use lower-case letters, digits and '_', for example 'tracker'"
        )
    return name


def require_same_frame(needed: str, got: str, what: str) -> None:
    """Raise FrameMismatchError naming both frames unless they are the same."""
    if needed != got:
        raise FrameMismatchError(f"{what}: needed frame '{needed}', got frame '{got}'")
