"""`dvf-ig calibrate probe`: map from image pixels to the probe's sensor."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, ProbeNameOption, ReferenceNameOption, SeedOption, command

from .output import MaxResidualOption, OutputOption, judge, save, show


def probe(
    sequence: Annotated[
        Path,
        Argument(
            help="Tracked images of the phantom; cross-wire and wall with --points: also poses as text."
        ),
    ],
    phantom: Annotated[Literal["nwire", "cross-wire", "wall"], Option(help="Imaged phantom.")] = "nwire",
    device_set: Annotated[
        Path | None, Option(help="N-wire: PLUS device-set XML with the phantom and its placement.")
    ] = None,
    points: Annotated[
        Path | None, Option(help="N-wire: PLUS results XML (CalibrationData). Others: table of points, px.")
    ] = None,
    validate: Annotated[Path | None, Option(help="A second sequence on which the error is measured.")] = None,
    validate_points: Annotated[
        Path | None,
        Option(
            help="N-wire: PLUS results XML (ValidationData; default: --points). Others: table of points, px."
        ),
    ] = None,
    method: Annotated[
        str | None,
        Option(
            help="N-wire: linear, orthogonal, isotropic or all-wires (default: the one with the least "
            "cross-validated error on the calibration frames). Others: orthogonal or isotropic."
        ),
    ] = None,
    picture: Annotated[
        Path | None, Option(help="N-wire without --points: PNG of the detected dots and wires.")
    ] = None,
    max_residual_mm: MaxResidualOption = None,
    probe_name: ProbeNameOption = None,
    reference_name: ReferenceNameOption = None,
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Find the map from image pixels to the probe's sensor, from an N-wire, cross-wire or wall phantom."""
    with command():
        import numpy as np

        from dvf_ig.io import ProbeNames
        from dvf_ig.io.plus.sequence_read import image_orientation

        names = ProbeNames.from_plus(probe_name, reference_name)
        rng = np.random.default_rng(seed)
        if phantom != "nwire":
            from .target import target_result

            calibrated = target_result(
                phantom, (sequence, points), (validate, validate_points), names, method, max_residual_mm, rng
            )
        else:
            from .nwire import nwire_result

            tables = (points, validate_points or points)
            calibrated = nwire_result(
                sequence, device_set, validate, tables, names, method, picture, max_residual_mm, rng
            )
        result = calibrated.result
        of_plus = phantom == "nwire" and points is not None  # PLUS's own points are of images in MF
        result["image_orientation"] = "MF" if of_plus else image_orientation(sequence)
        matrix = np.array(result["sensor_from_image"])
        name = f"{result['sensor_frame']}_from_image"
        save(output, result, name, matrix, calibrated.error_mm, calibrated.draw)
        show(result, calibrated.rows, as_json=as_json)
        judge(result)
