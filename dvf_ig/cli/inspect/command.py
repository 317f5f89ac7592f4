"""`dvf-ig inspect`: the kind of a file, and the facts to know before it is used."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dvf_ig.cli.shell import (
    EcgLeadOption,
    EcgRateOption,
    JsonFlag,
    ProbeNameOption,
    ReferenceNameOption,
    command,
    emit,
    output_file,
    wrote,
)

from .sequence import sequence_rows

SHOWN_VALUES = 12
"""Longest list that the table prints in full; --json always prints everything."""


def inspect(
    file: Annotated[
        str, typer.Argument(help="A file or folder, or an ECG as wfdb:, edf:, csv: or plus:PATH.")
    ],
    rate: EcgRateOption = None,
    lead: EcgLeadOption = None,
    probe_name: ProbeNameOption = None,
    reference_name: ReferenceNameOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            callback=output_file,
            help="Of a DICOM examination: draw where its slices lie (PNG).",
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Describe a file: sequence, image, mesh, model, transform, landmarks, ECG, PLUS XML, scenario.

    Of a folder with all DICOM series of an examination: the short-axis stack, the long-axis views, and what
    is left out and why.
    """
    with command():
        from dvf_ig.intake import describe
        from dvf_ig.io import ProbeNames, plain

        named = probe_name is not None or reference_name is not None
        names = ProbeNames.from_plus(probe_name, reference_name) if named else None
        description = describe(file, rate, names, lead)
        if output is not None:
            _draw(Path(file), description.kind, output)
        facts = plain(description.facts)
        table = sequence_rows(facts) if description.kind == "tracked sequence" else _rows(facts)
        rows = [("file", file), ("kind", description.kind), *table]
        emit({"file": file, "kind": description.kind, **facts}, rows, as_json=as_json)
        if output is not None:
            wrote(output)


def _draw(folder: Path, kind: str, output: Path) -> None:
    """Draw where the slices of an examination lie."""
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_dicom_examination
    from dvf_ig.report.examination import write_slices_picture

    if kind != "examination of DICOM images":
        raise InvalidInputError(
            f"-o draws the slices of a folder with all DICOM series of an examination; {folder} is: {kind}"
        )
    found = read_dicom_examination(folder)
    reasons = [f"{one.series or 'without a name'} ({one.images}): {one.reason}" for one in found.left_out]
    write_slices_picture(output, found.sax, found.views, found.names, reasons)


def _rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Build one row a fact, or one a member for a group of groups; transforms keep their names."""
    rows: list[tuple[str, str]] = []
    for name, value in facts.items():
        label = name.replace("_", " ")
        if name == "transforms":
            rows += [(member, _text(entry)) for member, entry in value.items()]
        elif isinstance(value, dict) and any(isinstance(entry, dict) for entry in value.values()):
            rows += [(f"{label} {member}", text) for member, text in _rows(value)]
        elif value not in (None, {}):
            rows.append((label, _text(value)))
    return rows


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        shown = ((str(k).replace("_", " "), v) for k, v in value.items() if v is not None)
        return "; ".join(f"{name} {_text(entry)}" for name, entry in shown)
    if isinstance(value, list):
        inner = ", ".join(_text(entry) for entry in value[:SHOWN_VALUES])
        more = len(value) - SHOWN_VALUES
        return f"({inner}, … {more} more)" if more > 0 else f"({inner})"
    return str(value)
