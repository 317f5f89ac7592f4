"""`dvf-ig inspect`: the kind of a file, and the facts to know before it is used."""

from pathlib import Path
from typing import Annotated, Any

from typer import Argument

from dvf_ig.cli import shell

SHOWN_VALUES = 12
"""Longest list that the table prints in full; --json always prints everything."""


def inspect(
    file: Annotated[str, Argument(help="A file or folder, or an ECG as wfdb:, edf:, csv: or plus:PATH.")],
    rate: shell.EcgRateOption = None,
    lead: shell.EcgLeadOption = None,
    probe_name: shell.ProbeNameOption = None,
    reference_name: shell.ReferenceNameOption = None,
    output: Annotated[
        Path | None, shell.out_file("Of a DICOM examination: draw where its slices lie (PNG).")
    ] = None,
    as_json: shell.JsonFlag = False,
) -> None:
    """Describe a file: sequence, image, mesh, model, transform, landmarks, ECG, PLUS XML, scenario.

    Of a folder with all DICOM series of an examination: the short-axis stack, the long-axis views, and what
    is left out and why.
    """
    with shell.command():
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
        shell.emit({"file": file, "kind": description.kind, **facts}, rows, as_json=as_json)
        if output is not None:
            shell.wrote(output)


def _draw(folder: Path, kind: str, output: Path) -> None:
    """Draw where the slices of an examination lie."""
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_dicom_examination
    from dvf_ig.report.examination import write_slices_picture

    if kind != "examination of DICOM images":
        raise InvalidInputError(
            f"-o draws the slices of a folder with all DICOM series of an examination; {folder} is: {kind}"
        )
    examination = read_dicom_examination(folder)
    reasons = [
        f"{one.series or 'without a name'} ({one.images}): {one.reason}" for one in examination.left_out
    ]
    write_slices_picture(output, examination.sax, examination.views, examination.names, reasons)


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


Facts = dict[str, Any]
Row = tuple[str, str]


def sequence_rows(facts: Facts) -> list[Row]:
    """Build rows (label, text) of the facts of one tracked sequence."""
    return [
        ("frames", _frames(facts)),
        _images(facts),
        *_clock(facts),
        *_tree(facts),
        *(("probe", f"{name}: {_moves(of)}") for name, of in facts.get("probe", {}).items()),
        *_fields(facts),
    ]


def _frames(facts: Facts) -> str:
    left_out = facts["frames_left_out"]
    return f"{facts['frames']}" + (f"; {left_out} without a time stamp are left out" if left_out else "")


def _images(facts: Facts) -> Row:
    size = facts["image_size_px"]
    if size is None:
        return ("images", "none: poses only")
    kind = "" if facts["pixel_type"] in ("MET_UCHAR", "uchar", "uint8") else f", pixels {facts['pixel_type']}"
    valid = _valid(facts["invalid_image_share"])
    turned = f" (read as {facts['turned_to']})" if facts["turned_to"] else ""
    return ("images", f"{size[0]} x {size[1]} px, orientation {facts['orientation']}{turned}, {valid}{kind}")


def _clock(facts: Facts) -> list[Row]:
    if not facts["has_timestamps"]:
        return [("clock", "no time stamps: frames are counted, latency and gating cannot use them")]
    if facts["rate_hz"] is None:
        return [("clock", "one time stamp")]
    rows = [
        (
            "clock",
            f"{facts['rate_hz']:.2f} frames/s for {facts['duration_s']:.2f} s from {facts['start_s']:.3f} s, "
            f"steps irregular by {1000 * facts['jitter_s']:.1f} ms (SD)",
        )
    ]
    missing, longest = facts["missing_frames"], 1000 * facts["longest_gap_s"]
    lost = f"{missing} frames missing" if missing else "no frame missing"
    rows.append(("gaps", f"{lost}, longest step {longest:.0f} ms, {facts['gaps']} beyond 250 ms"))
    rows.append(("stamps", _stamps(facts)))
    return rows


def _stamps(facts: Facts) -> str:
    repeated, backward = facts["repeated_stamps"], facts["backward_stamps"]
    order = "increasing" if not repeated and not backward else f"{repeated} repeated, {backward} step back"
    shift, restart = facts["stamp_filter_shift_s"], facts["clock_restart"]
    if restart is not None:
        order += (
            f"; the clock jumps back by {restart['back_s']:.3f} s at frame {restart['frame']}: "
            f"the {restart['unused_frames']} frames from there on are not used"
        )
    return order if not shift else f"{order}; the recorder's filter moved them by up to {1000 * shift:.0f} ms"


def _tree(facts: Facts) -> list[Row]:
    """Draw the frame tree, with the facts of each transform next to its child frame."""
    lines: list[str] = facts["frame_tree"]
    if not lines:
        return [("poses", "none recorded")]
    width = max(len(line) for line in lines)
    rows: list[Row] = []
    parents = [""]
    for line in lines:
        name = line.lstrip("│├└─ ")
        depth = (len(line) - len(name)) // 3
        parents = [*parents[:depth], name]
        text = _transform(facts, parents[depth - 1], name) if depth else ""
        rows.append(("poses" if not rows else "", f"{line:<{width}}  {text}".rstrip()))
    return rows


def _fields(facts: Facts) -> list[Row]:
    """Describe the ECG and other numbers in the frames' fields."""
    rows = [("ECG", f"field {name}: {_ecg(ecg)}") for name, ecg in facts["ecg"].items()]
    others = [name for name in facts["numeric_fields"] if name not in facts["ecg"]]
    return [*rows, ("other fields", ", ".join(others))] if others else rows


def _ecg(ecg: Facts) -> str:
    if "problem" in ecg:
        return f"not usable: {ecg['problem']}"
    leads, missing = ", ".join(ecg["leads"]), ecg["missing_share"]
    lost = f", {missing:.1%} missing" if missing else ""
    return (
        f"{leads} in {ecg['unit']}, {ecg['rate_hz']:.5g} Hz for {ecg['duration_s']:.2f} s "
        f"from {ecg['start_s']:.3f} s{lost}"
    )


def _transform(facts: Facts, parent: str, child: str) -> str:
    for name in (f"{parent}_from_{child}", f"{child}_from_{parent}"):
        transform = facts["transforms"].get(name)
        if transform is not None:
            return f"{name}: {_moves(transform)}"
        if name in facts["image_maps"]:
            return f"{name}: a map from pixels, not a pose"
    return ""


def _moves(moved: Facts) -> str:
    if moved["extent_mm"] is None:
        return _valid(moved["invalid_share"])
    extent = " x ".join(f"{side:.1f}" for side in moved["extent_mm"])
    frozen = f", frozen for {moved['frozen_share']:.0%}" if moved["frozen_share"] else ""
    wrong = f"; {moved['problem']}" if moved["problem"] else ""
    turned = f"turns {moved['turn_deg']:.1f} deg"
    return f"{_valid(moved['invalid_share'])}{frozen}, moves {extent} mm, {turned}{wrong}"


def _valid(invalid_share: float) -> str:
    return "all valid" if invalid_share == 0 else f"{invalid_share:.1%} INVALID"
