"""Printing and saving of calibration results with their uncertainty: JSON, PLUS XML, a picture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from dvf_ig.cli.shell import emit, out_file, warn, wrote

if TYPE_CHECKING:
    from dvf_ig.calibration import CalibrationErrors, MapUncertainty, NWireResult, TargetResult
    from dvf_ig.calibration.refusal import Refusal, RejectedFrame
    from dvf_ig.core import FloatArray, ImageMap


OutputOption = Annotated[Path | None, out_file("Write JSON here; PLUS XML and a picture go next to it.")]
MaxResidualOption = Annotated[
    float | None,
    Option(
        "--max-residual-mm",
        min=0.0,
        help="Largest residual that is accepted; raise it only if you know that this error is acceptable.",
    ),
]
DeviceSetOption = Annotated[
    Path, Option("--device-set", help="PLUS device-set XML with the phantom and its placement.")
]


@dataclass(frozen=True, slots=True, eq=False)
class ProbeCalibration:
    """Calibration of a probe for printing and saving.

    Attributes:
        result: JSON fields; rows: to print.
        error_mm: error that PLUS records.
        fit: whose error of each frame is drawn.
    """

    result: dict[str, Any]
    rows: list[tuple[str, ...]]
    error_mm: float
    fit: "NWireResult | TargetResult[Any]"

    def draw(self, png: Path) -> None:
        """Draw the error of each frame, also of those that were left out of the fit."""
        import numpy as np

        from dvf_ig.calibration import Rejection
        from dvf_ig.report import write_residual_picture

        errors, inliers = self.fit.calibration.errors_mm, self.fit.inliers
        usable = np.array(inliers)
        usable[[frame for frame, why in self.fit.rejected if why.reason is Rejection.OUTLIER]] = True
        of_frames = np.full(len(inliers), np.nan)
        of_frames[usable] = errors.reshape(len(errors), -1).mean(axis=1)
        title = marked(
            self.result, f"Probe image, {self.result['phantom']}: {error_row(self.fit.calibration)}"
        )
        write_residual_picture(png, of_frames, title=title, used=inliers, x_label="frame")


def save(
    output: Path | None,
    result: dict[str, Any],
    name: str | None,
    matrix: "FloatArray | None",
    error_mm: float | None,
    picture: Callable[[Path], None] | None = None,
) -> None:
    """Write a result as JSON with its date, its transform and a picture: all or none.

    A refused result has no PLUS XML, as that format cannot mark it as unusable.

    Args:
        output: file to write, or None to write nothing.
        result: the JSON object, with its `kind` and its verdict.
        name, matrix: the transform for PLUS XML, or None without one.
        error_mm: its error as PLUS records it.
        picture: draws the evidence into a PNG file.
    """
    if output is None:
        return
    from dvf_ig.io import CoordinateDefinition, files_together, write_coordinate_definitions, write_sidecar

    now = datetime.now(UTC)
    record = {**result, "date": now.isoformat(timespec="seconds")}
    json_path = output.with_suffix(".json") if output.suffix == ".xml" else output
    xml_path, png_path = output.with_suffix(".xml"), output.with_suffix(".png")
    placed = None
    if name is not None and matrix is not None and not result["refused"]:
        target, _, source = name.partition("_from_")
        placed = CoordinateDefinition(target, source, matrix, error_mm, now.strftime("%y%m%d_%H%M%S"))
    files = {
        json_path: None,
        **({xml_path: placed.target} if placed else {}),
        **({png_path: None} if picture else {}),
    }
    with files_together(output.parent, [path.name for path in files]) as new:
        write_sidecar(new / json_path.name, record, result["kind"])
        if placed:
            write_coordinate_definitions(new / xml_path.name, [placed])
        if picture is not None:
            picture(new / png_path.name)
    if result["refused"] and name is not None and matrix is not None:
        _warn_of_xml(xml_path)
    for path, frame in files.items():
        wrote(path, frame)


def _warn_of_xml(path: Path) -> None:
    if path.is_file():
        warn(f"{path} is of an earlier calibration and was left unchanged")
    else:
        warn(f"{path} was not written: PLUS XML cannot mark a calibration as refused")


def verdict(refusals: "Sequence[Refusal]") -> dict[str, Any]:
    """Build the JSON fields on whether the result must not be used, and why."""
    return {"refused": bool(refusals), "refused_because": [refusal.detail for refusal in refusals]}


def show(result: dict[str, Any], rows: Sequence[tuple[str, ...]], *, as_json: bool) -> None:
    """Print a result and why it is refused; infinite values of a refused one are null in JSON."""
    from dvf_ig.io import plain

    refused = [("REFUSED", why) for why in result["refused_because"]]
    emit(plain(result), [*rows, *refused], as_json=as_json)


def marked(result: dict[str, Any], title: str) -> str:
    """Mark the title of a picture if the result is refused."""
    return f"REFUSED - {title}" if result["refused"] else title


def judge(result: dict[str, Any]) -> None:
    """Raise for a refused result; last step of a command, after everything was written and printed.

    Raises:
        QualityGateError: the result is refused.
    """
    from dvf_ig.core import QualityGateError

    if result["refused"]:
        raise QualityGateError(f"this calibration must not be used: {'; '.join(result['refused_because'])}")


def vector(values: Sequence[float]) -> str:
    """Format coordinates to a thousandth."""
    return "(" + ", ".join(f"{v:.3f}" for v in values) + ")"


def image_fields(image: "ImageMap") -> dict[str, Any]:
    """Describe an image calibration: its matrix, and its parts with all digits, which the product loses."""
    return {
        "sensor_from_image": image.matrix.tolist(),
        "sensor_frame": image.rigid.target,
        "sensor_from_image_rigid": image.rigid.matrix.tolist(),
        "pixel_mm": image.scale_mm_per_px.tolist(),
    }


def error_fields(errors: "CalibrationErrors | None") -> dict[str, float | int] | None:
    """Build the JSON of the errors of one recording; null without one."""
    if errors is None:
        return None
    summary = errors.summary
    return {
        "mean_mm": summary.mean,
        "sd_mm": summary.sd,
        "mean95_mm": summary.mean95,
        "sd95_mm": summary.sd95,
        "frames_used": errors.frames_used,
        "frames": errors.frames,
    }


def error_row(errors: "CalibrationErrors") -> str:
    """Format errors of a calibration: of all frames, and of the lowest 95 %."""
    summary = errors.summary
    return (
        f"{summary.mean:.3f} ± {summary.sd:.3f} mm, lowest 95 %: {summary.mean95:.3f} ± "
        f"{summary.sd95:.3f} mm, {errors.frames_used} of {errors.frames} frames"
    )


def wire_rows(errors: "CalibrationErrors") -> list[tuple[str, str]]:
    """Build one row a wire: its error in the image plane."""
    return [(f"wire {name}", f"{length:.3f} mm in plane") for name, length in errors.in_plane_mm.items()]


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
