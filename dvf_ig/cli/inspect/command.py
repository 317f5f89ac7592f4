"""`dvf-ig inspect`: the kind of a file, and the facts to know before it is used."""

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
    as_json: JsonFlag = False,
) -> None:
    """Describe a file: sequence, image, mesh, model, transform, landmarks, ECG, PLUS XML, scenario."""
    with command():
        from dvf_ig.intake import describe
        from dvf_ig.io import ProbeNames, plain

        named = probe_name is not None or reference_name is not None
        names = ProbeNames.from_plus(probe_name, reference_name) if named else None
        description = describe(file, rate, names, lead)
        facts = plain(description.facts)
        table = sequence_rows(facts) if description.kind == "tracked sequence" else _rows(facts)
        rows = [("file", file), ("kind", description.kind), *table]
        emit({"file": file, "kind": description.kind, **facts}, rows, as_json=as_json)


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
