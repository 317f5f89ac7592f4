"""`dvf-ig calibrate device`: place of a haptic device, by touching reference points with it."""

import select
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, command

from .output import MaxResidualOption, OutputOption, judge, marked, save, show, verdict

if TYPE_CHECKING:
    from dvf_ig.core import FloatArray, Landmarks
    from dvf_ig.guidance.devices import HeldDevice

MAX_RMS_MM = 2.0
"""A larger residual says that a point was missed, or is not where its file says."""
HELD_S, LOOK_S = 0.2, 0.002


def device(
    points: Annotated[Path, Argument(help="Named points in the tracker's frame: .mrk.json, .fcsv or .tag.")],
    name: Annotated[
        str | None,
        Option(
            "--device", help="force-dimension or openhaptics: touch each point in turn, press its button."
        ),
    ] = None,
    touched: Annotated[
        Path | None, Option(help="The same points in the device's frame, from a file.")
    ] = None,
    max_residual_mm: MaxResidualOption = None,
    output: OutputOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Find the place of a haptic device, tracker_from_device, from three or more points that its tip touched.

    The file is what `calibration.device` of a session.yaml names, for `dvf-ig serve --device`.
    """
    with command():
        from dvf_ig.calibration import Gate, Refusal, register_landmarks
        from dvf_ig.io import read_landmarks
        from dvf_ig.report import write_residual_picture

        if (name is None) == (touched is None):
            raise typer.BadParameter(
                "give --device to touch the points now, or --touched with a file of them"
            )
        reference = read_landmarks(points, "tracker")
        contacts = _touch(reference, name or "") if touched is None else read_landmarks(touched, "device")
        names, target, source = reference.paired_with(contacts)
        fit = register_landmarks(target, source)
        limit_mm = MAX_RMS_MM if max_residual_mm is None else max_residual_mm
        refusals = list(fit.refusals)
        if fit.rms_mm > limit_mm:
            why = f"the points fit to {fit.rms_mm:.2f} mm RMS; at most {limit_mm:g} mm: touch them again"
            refusals.append(Refusal(Gate.RESIDUAL, why))
        fitted = fit.target_from_source
        result = {
            "kind": "landmarks",
            **verdict(refusals),
            "target_from_source": fitted.matrix.tolist(),
            "rms_mm": fit.rms_mm,
            "residuals_mm": fit.residuals_mm.tolist(),
            "landmarks": list(names),
            "target": fitted.target,
            "source": fitted.source,
        }
        title = marked(result, f"{fitted.name}: {fit.rms_mm:.2f} mm RMS over {len(names)} points")
        save(
            output, result, fitted.name, fitted.matrix, fit.rms_mm,
            lambda png: write_residual_picture(
                png, fit.residuals_mm, title=title, names=list(names), second=fit.leave_one_out_mm
            ),
        )  # fmt: skip
        errors = zip(names, fit.residuals_mm, strict=True)
        rows = [("transform", fitted.name), ("residual", f"{fit.rms_mm:.3f} mm RMS")]
        rows += [(f"point {one}", f"{residual:.3f} mm") for one, residual in errors]
        show(result, rows, as_json=as_json)
        judge(result)


def _touch(reference: "Landmarks", name: str) -> "Landmarks":
    """Positions of a device's tip at each point, which the user confirms by its button or Enter."""
    import numpy as np

    from dvf_ig.core import Landmarks, Points
    from dvf_ig.guidance.devices import open_device

    with closing(open_device(name)) as hardware:
        positions = []
        for point in reference.names:
            typer.echo(f"touch '{point}', hold still, and press the button or Enter", err=True)
            _wait_confirmed(hardware)
            positions.append(_held_mm(hardware))
    return Landmarks(reference.names, Points("device", np.array(positions)))


def _wait_confirmed(hardware: "HeldDevice") -> None:
    from dvf_ig.guidance.devices import position_mm

    pressed = True
    while True:
        position_mm(hardware)  # the button comes with the positions
        before, pressed = pressed, hardware.pressed
        if pressed and not before:
            return
        if select.select([sys.stdin], [], [], 0.0)[0]:
            sys.stdin.readline()
            return
        time.sleep(LOOK_S)


def _held_mm(hardware: "HeldDevice") -> "FloatArray":
    """Median of the tip's positions over HELD_S."""
    import numpy as np

    from dvf_ig.guidance.devices import position_mm

    until_s, seen = time.monotonic() + HELD_S, []
    while time.monotonic() < until_s:
        seen.append(position_mm(hardware))
        time.sleep(LOOK_S)
    return np.asarray(np.median(seen, axis=0))
