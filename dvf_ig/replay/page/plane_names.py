"""Orientation of a plane in the patient: its nearest standard plane, and the letters at its edges.

Axes are LPS: +x to the patient's left, +y to the back, +z to the head.
"""

import numpy as np

from dvf_ig.core import FloatArray

PLANES = ("sagittal", "coronal", "axial")
"""The planes across x, y and z."""
LETTERS = ("RL", "AP", "FH")
"""The sides towards which −x and +x, −y and +y, −z and +z point."""
SHARED = 0.5
"""Component along an axis from which a direction is named after it."""
OBLIQUE_DEG, ALIGNED_DEG = 25.0, 3.0


def plane_name(normal: FloatArray) -> str:
    """Name the plane across `normal` (3,), with its tilt if any."""
    share = np.abs(normal) / np.linalg.norm(normal)
    nearest = int(share.argmax())
    tilt_deg = float(np.degrees(np.arccos(min(share[nearest], 1.0))))
    if tilt_deg >= OBLIQUE_DEG:
        return f"oblique, {tilt_deg:.0f}° from {PLANES[nearest]}"
    if tilt_deg >= ALIGNED_DEG:
        return f"{PLANES[nearest]}, tilted by {tilt_deg:.0f}°"
    return PLANES[nearest]


def edge_letters(right: FloatArray, down: FloatArray) -> tuple[str, str, str, str]:
    """Name the sides of the patient at the left, right, upper and lower edge of an image.

    Args:
        right, down: (3,) directions in which its columns and rows count.
    """
    return _letters(-right), _letters(right), _letters(-down), _letters(down)


def _letters(direction: FloatArray) -> str:
    """List letters of the axes along a direction, the largest component first."""
    unit = direction / np.linalg.norm(direction)
    order = np.argsort(-np.abs(unit), kind="stable")
    return "".join(LETTERS[a][int(unit[a] > 0)] for a in order if abs(unit[a]) >= SHARED)


def viewed_upright(axes: FloatArray) -> tuple[int, int, bool, bool]:
    """Orient a plane as radiologists do: left of the patient to the right, head up, front up.

    Args:
        axes: (2, 3) unit directions of the plane's two axes.
    Returns:
        which axis runs along the columns and which along the rows, and whether each is reversed.
    """
    across = int(np.abs(np.cross(axes[0], axes[1])).argmax())
    right, down = (
        np.eye(3)[0 if across != 0 else 1],
        np.array([0.0, 1.0, 0.0]) if across == 2 else np.array([0.0, 0.0, -1.0]),
    )
    straight = abs(axes[0] @ right) + abs(axes[1] @ down)
    swapped = abs(axes[1] @ right) + abs(axes[0] @ down)
    column, row = (0, 1) if straight >= swapped else (1, 0)
    return column, row, bool(axes[column] @ right < 0), bool(axes[row] @ down < 0)
