"""SESSION.yaml as text: as `config init` begins it, with comments; complete, as `config dump` shows it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dvf_ig.intake.schema import SCHEMA, SessionDraft
from dvf_ig.io.yaml_text import yaml_text


@dataclass(frozen=True, slots=True)
class _Entry:
    """A key with its value, or with an example that is commented out, and what it is."""

    key: str
    value: Any
    example: str
    note: str = ""

    def line(self, indent: str) -> str:
        shown = self.example if self.value is None else _inline(self.value)
        lead = f"{indent}{self.key}: {shown}" if self.value is not None else f"{indent}# {self.key}: {shown}"
        return f"{lead}  # {self.note}" if self.note else lead


def session_text(draft: SessionDraft, found: Mapping[str, str | None]) -> str:
    """YAML with a comment for everything that it says or could say.

    Args:
        found: by key what the files hold.
    """
    blocks = [
        [
            "# The files of one intervention; names are relative to the folder of this file.",
            "#   dvf-ig config validate SESSION.yaml             opens them all and says what does not fit",
            "#   dvf-ig register --config SESSION.yaml -o OUT    where the patient is",
            "#   dvf-ig replay --config SESSION.yaml -o RUN      from raw streams to force",
            f"schema: {SCHEMA}",
            _Entry("patient_id", draft.patient_id, "P-17", "else the model's, or the image's name").line(""),
        ],
        _preop(draft, found),
        _ultrasound(draft, found),
        _recordings(draft, found),
        _calibration(draft, found),
        _start(draft, found),
        _fixtures(),
        _live(),
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def dump_text(config: SessionDraft) -> str:
    """YAML of the complete configuration, every default written out; it reads back to the same."""
    head = (
        "# Every key of a session's configuration; null: not given. Without fixtures one forbidden region\n"
        "# acts (its numbers: dvf-ig replay --help); without retiming the law is two-segment.\n"
    )
    document = config.model_dump(by_alias=True)
    return head + yaml_text(document, flow=None)


def _inline(value: Any) -> str:
    """A value on one line of YAML."""
    text = yaml_text([value], flow=True, width=10_000)
    return text.strip().removeprefix("[").removesuffix("]")


def _section(key: str, says: list[str], found: str | None, entries: list[_Entry]) -> list[str]:
    """Comments, then the section; its own line is commented out where nothing in it is given."""
    comments = [f"# {line}" for line in says]
    if found is not None:
        comments.append(f"# Found: {found}.")
    empty = all(entry.value is None for entry in entries)
    lines = [entry.line("  ") for entry in entries]
    if not empty:
        return [*comments, f"{key}:", *lines]
    return [*comments, f"# {key}:", *("#   " + line.removeprefix("  # ") for line in lines)]


def _preop(draft: SessionDraft, found: Mapping[str, str | None]) -> list[str]:
    preop = draft.preop
    given = {} if preop is None else preop.model_dump(exclude_defaults=True)
    labelled = preop is not None and preop.labels is not None
    entries = [
        _Entry("model", given.get("model"), "heart.npz", "made by: dvf-ig model build"),
        _Entry("mr", given.get("mr"), "cine.nrrd", "4-D grey levels, which ultrasound is compared with"),
        _Entry("labels", given.get("labels"), "labels.nii.gz", "4-D; with mr, 3-D of one phase is enough"),
    ]
    if labelled:
        organ, cavity = given.get("organ_labels"), given.get("cavity_labels")
        entries += [
            _Entry("ed_phase", given.get("ed_phase"), "0", "the phase of mr that 3-D labels belong to"),
            _Entry("organ_labels", organ and list(organ), "[1, 2]", "inside the protected surface"),
            _Entry(
                "cavity_labels",
                cavity and list(cavity),
                "[2]",
                "of them, blood: ultrasound shows its border",
            ),
        ]
    entries += [
        _Entry(
            "surfaces_folder", given.get("surfaces_folder"), "surfaces", "meshes NAME_0.vtp, NAME_1.vtp, …"
        ),
        _Entry("timing", None, "timing.json", "times of the phases; else timing.json beside the images"),
    ]
    says = ["The heart before the operation, in frame mr (LPS, mm)."]
    return _section("preop", says, found["preop"], entries)


def _ultrasound(draft: SessionDraft, found: Mapping[str, str | None]) -> list[str]:
    us = draft.ultrasound
    return _section(
        "ultrasound",
        ["Tracked ultrasound: images, and poses of the probe (mm), on the clock of the video (s)."],
        found["ultrasound"],
        [
            _Entry("file", us.file, ""),
            _Entry("probe_name", us.probe_name, "Probe", "the probe's marker, as the recording names it"),
            _Entry("reference_name", us.reference_name, "Reference", "what its poses are relative to"),
            _Entry(
                "fan",
                None,
                "{apex_px: [128, 10], start_px: 20, stop_px: 240, half_angle_rad: 0.6}",
                "else the sector is found in the images",
            ),
        ],
    )


def _recordings(draft: SessionDraft, found: Mapping[str, str | None]) -> list[str]:
    ecg, tool = draft.ecg, draft.tool
    of_sweep = "in the ultrasound's file: " if ecg is None and found["ecg"] is not None else ""
    tool_of_sweep = "in the ultrasound's file: " if tool is None and found["tool"] is not None else ""
    lines = _section(
        "ecg",
        [
            "ECG on the clock of the tracker (s): wfdb:RECORD, edf:FILE, csv:FILE or plus:SEQUENCE; or the",
            "pulses of a trigger in its place: trigger:FILE.",
        ],
        None if found["ecg"] is None else of_sweep + found["ecg"],
        [
            _Entry("file", None if ecg is None else ecg.file, "edf:ecg.edf"),
            _Entry("rate_hz", None if ecg is None else ecg.rate_hz, "250", "of a table without times"),
            _Entry(
                "start_s",
                None if ecg is None else ecg.start_s,
                "12.5",
                "when another recorder took its first sample, s on the tracker's clock",
            ),
            _Entry("delay_s", None, "0.02", "of a trigger: how long after the R peak it fires"),
        ],
    )
    lines += [
        "",
        *_section(
            "tool",
            ["Poses of the tool (mm) on the clock of the tracker (s); a replay needs them."],
            None if found["tool"] is None else tool_of_sweep + found["tool"],
            [
                _Entry("file", None if tool is None else tool.file, "tool.igs.mha"),
                _Entry("name", None if tool is None else tool.name, "Stylus", "as the recording names it"),
            ],
        ),
    ]
    return lines


def _calibration(draft: SessionDraft, found: Mapping[str, str | None]) -> list[str]:
    calibration = draft.calibration
    says = ["Calibrations: what dvf-ig calibrate … -o FILE wrote (a probe's and a tip's also as PLUS XML)."]
    says += [
        f"Found: {name} {text}."
        for name in ("probe", "latency", "tip")
        if (text := found[f"calibration.{name}"])
    ]
    return _section(
        "calibration",
        says,
        None,
        [
            _Entry("probe", calibration.probe, "probe.json", "probe_from_image, mm per pixel"),
            _Entry("latency", calibration.latency, "latency.json", "file, or s: tracker = video + latency"),
            _Entry("tip", calibration.tip, "tip.json", "of the tool, mm in its own frame; a replay needs it"),
        ],
    )


def _start(draft: SessionDraft, found: Mapping[str, str | None]) -> list[str]:
    start = draft.start
    return _section(
        "start",
        ["Where registration starts: one of the three; what is given beside the first checks the result."],
        found["start"],
        [
            _Entry("transform", start.transform, "start.tfm", "mr_from_tracker within 10 mm or so, ITK"),
            _Entry("landmarks_mr", start.landmarks_mr, "model.mrk.json", "marked on the images or model"),
            _Entry(
                "landmarks_tracker",
                start.landmarks_tracker,
                "patient.mrk.json",
                "the same points on the patient, mm",
            ),
            _Entry("touched", start.touched, "touched.csv", "x, y, z all over the heart's surface (mm)"),
            _Entry("touched_phase", None, "0.0", "when in the cycle [0, 1); else end-diastole"),
        ],
    )


def _fixtures() -> list[str]:
    return [
        "# What acts on the tool; unless given, this one (laws and their numbers: dvf-ig replay --help).",
        "# fixtures:",
        "#   - {law: forbidden, gamma: 1.0, depth_mm: 0.0, cap_n: 0.6}",
        "# retiming: two-segment  # how the beat is mapped to the model's cycle; or uniform",
        "# margin: off  # by which fixtures are widened: off, fixed (2 mm), a number of mm, or adaptive",
        "# device: {name: omega.3, continuous_force_n: 12}  # what renders them, for forces above 4 N",
    ]


def _live() -> list[str]:
    return [
        "# What PLUS or 3D Slicer sends, for dvf-ig serve (guide/live.md).",
        "# live:",
        "#   probe: ProbeToTracker",
        "#   tool: ToolToTracker",
        "#   image: Image_Tracker",
        "#   ecg: {field: EcgData, rate_hz: 500}",
    ]
