"""`dvf-ig force`: what a fixture would push at given points and one phase."""

import csv
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.core import FloatArray, UnreadableFileError

from .shell import JsonFlag, command, emit

if TYPE_CHECKING:
    from dvf_ig.guidance import ForceSamples, Law


class LawName(StrEnum):
    """Force laws by name."""

    sigmoid = "sigmoid"
    gaussian = "gaussian"


class BlendName(StrEnum):
    """How two phases are blended."""

    force = "force"
    distance = "distance"


def force(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file.")],
    points: Annotated[
        Path,
        typer.Option("--points", help="CSV of x,y,z in mm in the model's frame (LPS); a header is allowed."),
    ],
    phase: Annotated[
        float, typer.Option("--phase", help="Place in the model's cycle, 0 at the R peak, modulo 1.")
    ],
    law: Annotated[LawName, typer.Option("--law", help="Force law.")] = LawName.sigmoid,
    gamma: Annotated[float, typer.Option("--gamma", help="Sigmoid: steepness in 1/mm.")] = 1.0,
    delta_mm: Annotated[float, typer.Option("--delta-mm", help="Gaussian: width in mm.")] = 3.0,
    exponent: Annotated[float, typer.Option("--m", help="Gaussian: exponent.")] = 1.0,
    cap_n: Annotated[float, typer.Option("--cap-n", help="Largest force in N.")] = 0.6,
    depth_mm: Annotated[float, typer.Option("--depth-mm", help="Depth of the guarded surface in mm.")] = 0.0,
    blend: Annotated[BlendName, typer.Option("--blend", help="How phases are blended.")] = BlendName.force,
    stiffness: Annotated[
        float, typer.Option("--device-stiffness", help="Stiffest wall the device renders, in N/m.")
    ] = 400.0,
    as_json: JsonFlag = False,
) -> None:
    """Evaluate a dynamic fixture; a point outside the model's box gets no force and says so."""
    with command():
        if not math.isfinite(phase):
            raise typer.BadParameter(f"--phase is {phase}; needed a finite number")
        from dvf_ig.guidance import DeviceLimits, Evaluator, Gaussian, Sigmoid
        from dvf_ig.io import read_model

        limits = DeviceLimits(stiffness_n_per_m=stiffness)
        chosen: Law
        if law is LawName.sigmoid:
            chosen = Sigmoid(gamma, cap_n, depth_mm)
        else:
            chosen = Gaussian(delta_mm, exponent, cap_n, depth_mm)
        model = read_model(model_file)
        xyz_mm = _read_points(points)
        samples = Evaluator(model, chosen, blend=blend.value, device=limits).force(xyz_mm, phase)
        _print(samples, xyz_mm, model.frame, as_json)


def _print(samples: "ForceSamples", xyz_mm: FloatArray, frame: str, as_json: bool) -> None:
    from dvf_ig.guidance import Status

    names = [Status(code).name for code in samples.status.tolist()]
    payload = {
        "force_n": samples.force_n.tolist(),
        "distance_mm": [d if math.isfinite(d) else None for d in samples.distance_mm.tolist()],
        "status": names,
        "frame": frame,
    }
    rows = [("x y z (mm)", "force x y z (N)         distance (mm)  status")]
    for point, push, distance, name in zip(xyz_mm, samples.force_n, samples.distance_mm, names, strict=True):
        where = " ".join(f"{c:8.2f}" for c in point)
        rows.append((where, " ".join(f"{c:7.3f}" for c in push) + f"  {distance:12.3f}  {name}"))
    emit(payload, rows, as_json=as_json)


def _read_points(path: Path) -> FloatArray:
    """(n, 3) rows of a CSV; the first row may be a header.

    Raises:
        UnreadableFileError: absent, empty, or a row that is not three numbers.
    """
    import numpy as np

    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as exc:
        raise UnreadableFileError(f"cannot read points from {path}: {exc}") from exc
    rows: list[list[float]] = []
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        if not row:
            continue
        try:
            values = [float(cell) for cell in row]
        except ValueError as exc:
            if number == 1:
                continue
            raise UnreadableFileError(f"{path}, line {number}: '{','.join(row)}' is not x,y,z in mm") from exc
        if len(values) != 3:
            raise UnreadableFileError(f"{path}, line {number}: {len(values)} columns; needed x,y,z in mm")
        rows.append(values)
    if not rows:
        raise UnreadableFileError(f"{path} holds no points; needed lines of x,y,z in mm")
    return np.array(rows)
