"""How calibration results are printed and saved: JSON, and PLUS XML and a picture beside it."""

import hashlib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import wrote

if TYPE_CHECKING:
    from dvf_ig.calibration import TargetErrors, WireErrors
    from dvf_ig.core import FloatArray

OutputOption = Annotated[
    Path | None,
    typer.Option("-o", "--out", help="Write JSON here; PLUS XML and a picture go beside it."),
]
DeviceSetOption = Annotated[
    Path, typer.Option("--device-set", help="PLUS device-set XML with the phantom and its placement.")
]


def save(
    output: Path | None,
    result: dict[str, Any],
    name: str | None,
    matrix: "FloatArray | None",
    error_mm: float | None,
    inputs: Sequence[Path],
    picture: Callable[[Path], None] | None = None,
) -> None:
    """Write a result as JSON with date and digests of its inputs; beside it its transform and a picture.

    Args:
        output: where to, or None to write nothing.
        result: the JSON object.
        name, matrix: the transform for PLUS XML, or None where there is none.
        error_mm: its error as PLUS records it.
        inputs: files whose digests are kept.
        picture: draws the evidence into the PNG file it is given.
    """
    if output is None:
        return
    from dvf_ig.io import CoordinateDefinition, write_coordinate_definitions, write_json

    now = datetime.now(UTC)
    record = {
        **result,
        "date": now.isoformat(timespec="seconds"),
        "inputs": [{"file": path.name, "sha256": _digest(path)} for path in inputs],
    }
    json_path = output.with_suffix(".json") if output.suffix == ".xml" else output
    write_json(json_path, record)
    wrote(json_path)
    if name is not None and matrix is not None:
        target, _, source = name.partition("_from_")
        stamp = now.strftime("%y%m%d_%H%M%S")
        xml_path = output.with_suffix(".xml")
        definition = CoordinateDefinition(target, source, matrix, error_mm, stamp)
        write_coordinate_definitions(xml_path, [definition])
        wrote(xml_path, target)
    if picture is not None:
        png_path = output.with_suffix(".png")
        picture(png_path)
        wrote(png_path)


def vector(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.3f}" for v in values) + ")"


def wire_errors(errors: "TargetErrors | WireErrors") -> dict[str, float | int]:
    return {
        "mean_mm": errors.mean_mm,
        "sd_mm": errors.sd_mm,
        "mean95_mm": errors.mean95_mm,
        "sd95_mm": errors.sd95_mm,
        "frames_used": errors.frames_used,
        "frames": errors.frames,
    }


def error_row(errors: "TargetErrors | WireErrors") -> str:
    return (
        f"{errors.mean_mm:.3f} ± {errors.sd_mm:.3f} mm, lowest 95 %: {errors.mean95_mm:.3f} ± "
        f"{errors.sd95_mm:.3f} mm, {errors.frames_used} of {errors.frames} frames"
    )


def wire_rows(errors: "WireErrors") -> list[tuple[str, str]]:
    return [
        (f"wire {name}", f"{miss:.3f} mm in plane")
        for name, miss in zip(errors.wire_names, errors.in_plane_mm, strict=True)
    ]


def _digest(path: Path) -> str | None:
    """SHA-256 of a file, or of the files of a folder in order of their names."""
    digest = hashlib.sha256()
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()
