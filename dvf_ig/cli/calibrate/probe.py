"""`dvf-ig calibrate probe`: where an image pixel lies in the probe's sensor."""

from enum import StrEnum
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit

from .output import OutputOption, error_fields, error_row, save, wire_rows
from .uncertainty import map_rows, rejected_list, rejected_rows, uncertainty
from .wires import read_wires, segmentation_json, segmentation_rows

if TYPE_CHECKING:
    from dvf_ig.calibration import CalibrationErrors, NWireResult, NWireVariants


class Phantom(StrEnum):
    """What was imaged."""

    nwire = "nwire"
    crosswire = "cross-wire"
    wall = "wall"


def probe(
    sequence: Annotated[Path, typer.Argument(help="Tracked images of the phantom.")],
    phantom: Annotated[Phantom, typer.Option("--phantom", help="What was imaged.")] = Phantom.nwire,
    device_set: Annotated[
        Path | None,
        typer.Option("--device-set", help="N-wire: PLUS device-set XML with the phantom and its placement."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", help="N-wire: PLUS results XML (CalibrationData). Others: CSV of points."),
    ] = None,
    validate: Annotated[
        Path | None, typer.Option("--validate", help="A second sequence to measure the error on.")
    ] = None,
    validate_points: Annotated[
        Path | None,
        typer.Option(
            "--validate-points",
            help="N-wire: PLUS results XML (ValidationData; default: --points). Others: CSV of points.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            help="N-wire: linear, orthogonal, isotropic or all-wires (default: the one with the least "
            "cross-validated error on the calibration frames). Others: orthogonal or isotropic.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="N-wire without --points: PNG of the dots and wires that were found."),
    ] = None,
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Map from image pixels to the probe's sensor, from an N-wire, cross-wire or wall phantom."""
    with command():
        import numpy as np

        rng = np.random.default_rng(seed)
        if phantom is not Phantom.nwire:
            from .target import calibrate_target

            calibrated = calibrate_target(
                phantom.value, sequence, points, validate, validate_points, method, rng
            )
        else:
            tables = (points, validate_points or points)
            calibrated = _nwire(sequence, device_set, validate, tables, method, picture, rng)
        result, rows, error_mm = calibrated
        files = (sequence, device_set, points, validate, validate_points)
        inputs = [p for p in files if p is not None]
        matrix = np.array(result["sensor_from_image"])
        save(output, result, f"{result['sensor_frame']}_from_image", matrix, error_mm, inputs)
        emit(result, rows, as_json=as_json)


def _nwire(
    sequence: Path,
    device_set: Path | None,
    validate: Path | None,
    tables: tuple[Path | None, Path | None],
    method: str | None,
    picture: Path | None,
    rng: Any,
) -> tuple[dict[str, Any], list[tuple[str, ...]], float]:
    """JSON, rows to print and the error to save."""
    from dvf_ig.calibration import compare_nwire_methods, validate_nwire
    from dvf_ig.core import InvalidInputError

    if device_set is None:
        raise InvalidInputError("an N-wire phantom needs --device-set XML with its wires and its placement")
    seen = read_wires(sequence, device_set, tables[0], "CalibrationData", picture)
    validated = None
    if validate is not None:
        validated = read_wires(validate, device_set, tables[1], "ValidationData")
    recording, held_out = seen.recording, None if validated is None else validated.recording
    variants = compare_nwire_methods(recording, rng=rng)
    found = _chosen(variants, method)
    checked = {
        name: None if held_out is None else validate_nwire(r.probe_from_image, held_out)
        for name, r in variants.results.items()
    }
    result = _probe_result(found, checked[found.method])
    result["method_from"] = "cross-validation of the calibration frames" if method is None else "--method"
    result["variants"] = _variants(variants, checked)
    result["segmentation"] = segmentation_json(seen)
    result["validation_segmentation"] = segmentation_json(validated)
    rows: list[tuple[str, ...]] = [*segmentation_rows(seen, validated)]
    rows += [*_probe_rows(found, checked[found.method]), *_variant_rows(result)]
    return result, rows, (checked[found.method] or found.calibration).summary.mean95


def _chosen(variants: "NWireVariants", method: str | None) -> "NWireResult":
    from dvf_ig.calibration import NWIRE_METHODS
    from dvf_ig.core import InvalidInputError, QualityGateError

    if method is None:
        return variants.best
    for name in NWIRE_METHODS:
        if name == method:
            if name in variants.refused:
                raise QualityGateError(f"method {name}: {variants.refused[name]}")
            return variants.results[name]
    raise InvalidInputError(f"probe method '{method}' is unknown; choose {', '.join(NWIRE_METHODS)}")


def _probe_result(found: "NWireResult", checked: "CalibrationErrors | None") -> dict[str, Any]:
    return {
        "sensor_from_image": found.matrix.tolist(),
        "sensor_frame": found.probe_from_image.rigid.target,
        "phantom": Phantom.nwire.value,
        "calibration": error_fields(found.calibration),
        "validation": error_fields(checked),
        "method": found.method,
        "inlier_frames": int(found.inliers.sum()),
        "rejected": rejected_list(found.rejected),
        "edge_sd_mm": found.edge_sd_mm,
        "shear_deg": found.shear_deg,
        "leave_one_out_rms_mm": float((found.uncertainty.held_out_mm**2).mean() ** 0.5),
        "uncertainty": uncertainty(found.uncertainty),
    }


def _variants(
    variants: "NWireVariants", checked: "dict[Any, CalibrationErrors | None]"
) -> dict[str, dict[str, Any]]:
    from dvf_ig.calibration import NWIRE_METHODS

    table: dict[str, dict[str, Any]] = {}
    for name in NWIRE_METHODS:
        if name in variants.refused:
            table[name] = {"refused": variants.refused[name]}
            continue
        errors = checked[name]
        table[name] = {
            "calibration": error_fields(variants.results[name].calibration),
            "validation": error_fields(errors),
            "cross_validated_mean95_mm": variants.cross_validated_mm[name],
            "in_plane_mm": fmean((errors or variants.results[name].calibration).in_plane_mm.values()),
        }
    return table


def _probe_rows(found: "NWireResult", checked: "CalibrationErrors | None") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("frames used", f"{int(found.inliers.sum())} of {found.calibration.frames}"),
        *map_rows(found.uncertainty),
        ("calibration", error_row(found.calibration)),
    ]
    if checked is not None:
        rows.append(("validation", error_row(checked)))
    rows += rejected_rows(found.rejected)
    return rows + list(wire_rows(checked or found.calibration))


def _variant_rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """A table of the methods: lowest 95 % of the errors, in mm."""
    rows: list[tuple[str, ...]] = [
        ("method", "cross-validated  calibration  validation  in plane (mm; all but the last: lowest 95 %)")
    ]
    for name, entry in result["variants"].items():
        used = " *" if name == result["method"] else ""
        if "refused" in entry:
            rows.append((name, entry["refused"]))
            continue
        checked = entry["validation"]
        held_out = "-" if checked is None else f"{checked['mean95_mm']:.3f}"
        crossed, fitted = entry["cross_validated_mean95_mm"], entry["calibration"]["mean95_mm"]
        rows.append(
            (name + used, f"{crossed:<15.3f}  {fitted:<11.3f}  {held_out:<10}  {entry['in_plane_mm']:.3f}")
        )
    return [*rows, ("* used", f"chosen by {result['method_from']}")]
