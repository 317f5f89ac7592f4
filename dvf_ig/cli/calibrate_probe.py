"""`dvf-ig calibrate probe`: where an image pixel lies in the probe's sensor."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .calibrate_output import (
    DeviceSetOption,
    OutputOption,
    error_row,
    save,
    vector,
    wire_errors,
    wire_rows,
)
from .shell import JsonFlag, SeedOption, command, emit

if TYPE_CHECKING:
    from dvf_ig.calibration import ProbeResult, WireErrors


def probe(
    sequence: Annotated[Path, typer.Argument(help="Tracked images of the N-wire phantom.")],
    device_set: DeviceSetOption,
    points: Annotated[
        Path | None, typer.Option("--points", help="PLUS results XML: wire points, CalibrationData.")
    ] = None,
    validate: Annotated[
        Path | None, typer.Option("--validate", help="A second sequence to measure the error on.")
    ] = None,
    validate_points: Annotated[
        Path | None,
        typer.Option("--validate-points", help="PLUS results XML: ValidationData (default: --points)."),
    ] = None,
    method: Annotated[
        str, typer.Option("--method", help="linear, orthogonal, isotropic or all-wires.")
    ] = "orthogonal",
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Map from image pixels to the probe's sensor, from an N-wire phantom."""
    with command():
        from typing import cast

        import numpy as np

        from dvf_ig.calibration import ProbeMethod, ProbeOptions, calibrate_probe, validate_probe
        from dvf_ig.io import read_nwire_recording

        first = _needed_points(points, sequence)
        recording = read_nwire_recording(sequence, device_set, first, "CalibrationData")
        held_out = None
        if validate is not None:
            held_out = read_nwire_recording(validate, device_set, validate_points or first, "ValidationData")
        options = ProbeOptions(method=cast(ProbeMethod, method))
        found = calibrate_probe(recording, rng=np.random.default_rng(seed), options=options)
        checked = validate_probe(found.probe_from_image, held_out) if held_out is not None else None
        result = _probe_result(found, checked)
        error = (checked or found.calibration).mean95_mm
        inputs = [p for p in (sequence, device_set, points, validate, validate_points) if p is not None]
        save(output, result, f"{result['sensor_frame']}_from_image", found.matrix, error, inputs)
        emit(result, _probe_rows(found, checked), as_json=as_json)


def _probe_result(found: "ProbeResult", checked: "WireErrors | None") -> dict[str, Any]:
    return {
        "sensor_from_image": found.matrix.tolist(),
        "sensor_frame": found.probe_from_image.rigid.target,
        "calibration": wire_errors(found.calibration),
        "validation": None if checked is None else wire_errors(checked),
        "method": found.method,
        "inlier_frames": int(found.inliers.sum()),
        "edge_sd_mm": found.edge_sd_mm,
        "shear_deg": found.shear_deg,
    }


def _probe_rows(found: "ProbeResult", checked: "WireErrors | None") -> list[tuple[str, str]]:
    scale, sensor = found.probe_from_image.scale_mm_per_px, found.probe_from_image.rigid.target
    rows = [
        ("frames used", f"{int(found.inliers.sum())} of {found.calibration.frames}"),
        ("pixel size", f"{scale[0]:.5f} x {scale[1]:.5f} mm"),
        ("image origin", f"{vector(found.matrix[:3, 3].tolist())} mm in '{sensor}'"),
        ("calibration", error_row(found.calibration)),
    ]
    if checked is not None:
        rows.append(("validation", error_row(checked)))
    return rows + wire_rows(checked or found.calibration)


def _needed_points(points: Path | None, sequence: Path) -> Path:
    from dvf_ig.core import InvalidInputError

    if points is None:
        raise InvalidInputError(
            f"wires are not yet found in the images of {sequence}; give their positions with "
            "--points RESULTS.xml (the file that PLUS's fCal writes)"
        )
    return points
