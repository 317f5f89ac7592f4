"""Printing and saving of an image calibration's uncertainty and rejected frames."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .output import vector

if TYPE_CHECKING:
    from dvf_ig.calibration import MapUncertainty, RejectedFrame

AXES = ("lateral", "axial", "elevation")


def uncertainty(spread: "MapUncertainty") -> dict[str, Any]:
    """Build 95 % half-widths along and about the image's axes, and 95 % intervals of pixel sizes."""
    import numpy as np

    origin = spread.point_mm(np.zeros(2))
    sizes = spread.scale_mm_per_px
    return {
        "center_px": spread.parameters.center_px.tolist(),
        "center_mm": spread.parameters.center_mm.tolist(),
        "center_half_width_mm": dict(zip(AXES, spread.center_mm.tolist(), strict=True)),
        "center_sd_mm": spread.center_sd_mm,
        "origin_half_width_mm": dict(zip(AXES, origin.tolist(), strict=True)),
        "rotation_half_width_deg": dict(zip(AXES, spread.rotation_deg.tolist(), strict=True)),
        "column_mm_per_px": sizes[0].tolist(),
        "row_mm_per_px": sizes[1].tolist(),
        "parameters": list(spread.parameters.names),
        "covariance": spread.covariance.tolist(),
    }


def rejected_list(rejected: "Sequence[tuple[int, RejectedFrame]]") -> list[dict[str, Any]]:
    """Describe rejected frames as JSON."""
    return [{"frame": frame, "reason": why.detail} for frame, why in rejected]


def rejected_rows(rejected: "Sequence[tuple[int, RejectedFrame]]") -> list[tuple[str, ...]]:
    """Build one row for each rejected frame."""
    return [(f"frame {frame}", why.detail) for frame, why in rejected]


def map_rows(spread: "MapUncertainty") -> list[tuple[str, ...]]:
    """Build rows of pixel size, origin and the image's middle with their 95 % half-widths."""
    estimate = spread.parameters.estimate
    scale, sensor = estimate.scale_mm_per_px, estimate.rigid.target
    half = 0.5 * (spread.scale_mm_per_px[:, 1] - spread.scale_mm_per_px[:, 0])
    widths = ", ".join(f"{v:.2f}" for v in spread.center_mm)
    angles = ", ".join(f"{v:.2f}" for v in spread.rotation_deg)
    column, row = spread.parameters.center_px
    return [
        ("pixel size", f"{scale[0]:.5f} ± {half[0]:.5f} x {scale[1]:.5f} ± {half[1]:.5f} mm"),
        ("image origin", f"{vector(estimate.rigid.translation_mm.tolist())} mm in '{sensor}'"),
        (
            f"pixel {column:.0f}, {row:.0f}",
            f"{vector(spread.parameters.center_mm.tolist())} mm ± {widths} (lateral, axial, elevation)",
        ),
        ("rotation", f"± {angles} deg about lateral, axial, elevation (95 %)"),
    ]
