"""Write a scenario as a folder: recordings at the top, everything that is truth under `truth/`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dvf_ig.core import CycleTiming, NWireRecording, PoseStream, Rigid, Signal, TrackedSequence, TriggerTimes
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.scenario import LatencyRecording, Preop, Scenario
from dvf_ig.guidance import FixtureSet
from dvf_ig.io import (
    write_ecg_csv,
    write_json,
    write_landmarks,
    write_model,
    write_points,
    write_surface_series,
)
from dvf_ig.io.ecg.trigger import TRIGGER_PREFIX, write_triggers
from dvf_ig.io.image.timing import timing_document
from dvf_ig.io.image.volume import write_volume, write_volume_series
from dvf_ig.io.plus.latency import write_line_table
from dvf_ig.io.plus.nwire import write_nwire_phantom, write_wire_points
from dvf_ig.io.plus.sequence_write import write_poses, write_sequence
from dvf_ig.io.respiration import write_channels
from dvf_ig.io.transform import write_transform
from dvf_ig.io.truth import write_truth
from dvf_ig.io.writing.atomic import atomic_folder, write_bytes, write_text
from dvf_ig.io.writing.place import make_folder
from dvf_ig.io.yaml_text import yaml_text

from .fixtures import FixturesConfig, structure_files
from .scenario import (
    CONFIG,
    FIXTURES,
    PREVIEW,
    README,
    SPEC,
    TRIGGER,
    TRUTH,
    FilesConfig,
    ScenarioConfig,
    ScenarioPreop,
    config_text,
)
from .schema import FanConfig

EXAMINATION = "examination.json"
"""Beside the truth: shift and RR interval of every breath-hold, and the base's descent."""


@dataclass(frozen=True, slots=True)
class ScenarioNotes:
    """Notes on a synthetic scenario beyond its recordings.

    Attributes:
        faults: one sentence each, without values of the ground truth.
        spec: YAML from which the scenario can be made again; it is written into truth/.
        preview_png: a picture of the scenario as a PNG file's bytes, see `dvf_ig.report.preview_png`.
        examination: truth of the MR's breath-holds; it is written into truth/.
        fixtures: what acts on the tool in place of one forbidden region.
    """

    faults: tuple[str, ...] = ()
    spec: str = ""
    preview_png: bytes | None = None
    examination: Mapping[str, object] | None = None
    fixtures: FixtureSet | None = None


def write_scenario(scenario: Scenario, folder: Path | str, notes: ScenarioNotes | None = None) -> None:
    """Write a scenario folder whole or not at all; `read_scenario` gives back every array exactly.

    An existing scenario folder that nobody changed is replaced; any other that is not empty is refused.

    Args:
        notes: for people: what README.md, preview.png and truth/spec.yaml say; None leaves these out.
    Raises:
        OutputError: the folder holds something else, or cannot be written.
        InvalidInputError: neither labels nor surfaces, a recording is missing, or a name that its file format
            cannot hold.
    """
    config = _config(scenario)
    if notes is not None and notes.fixtures is not None:
        files = config.files.model_copy(update={"fixtures": FIXTURES})
        config = config.model_copy(update={"files": files})
    tool, tip, probe, latency = scenario.tool, scenario.tip, scenario.probe, scenario.latency
    if tool is None or not isinstance(tip, PoseStream) or not isinstance(probe, NWireRecording):
        raise InvalidInputError("a scenario folder holds tool, pivot and N-wire recordings; one is missing")
    if not isinstance(latency, LatencyRecording):
        raise InvalidInputError("a scenario folder holds a water-tank recording, not a latency")
    with atomic_folder(Path(folder)) as new:
        for part in ("preop", "calibration"):
            make_folder(new / part)
        write_preop(scenario.preop, new, config.preop)
        files = config.files
        if isinstance(scenario.ecg, TriggerTimes):
            write_triggers(scenario.ecg, new / TRIGGER)
        else:
            write_ecg_csv(scenario.ecg, new / files.ecg)
        write_sequence(scenario.ultrasound, new / files.ultrasound)
        write_poses(tool, new / files.tool, scenario.tool_after_restart)
        write_poses(tip, new / files.pivot)
        if scenario.ventilator is not None and files.ventilator is not None:
            write_channels(scenario.ventilator, new / files.ventilator)
        if scenario.chest is not None and files.chest is not None:
            write_poses(scenario.chest, new / files.chest)
        _write_nwire(probe, new, files)
        _write_latency(latency, new, files)
        if scenario.start is not None and files.start is not None:
            write_transform(scenario.start, new / files.start)
        if scenario.landmarks_mr is not None and files.landmarks_mr is not None:
            write_landmarks(scenario.landmarks_mr, new / files.landmarks_mr)
        if scenario.landmarks_tracker is not None and files.landmarks_tracker is not None:
            write_landmarks(scenario.landmarks_tracker, new / files.landmarks_tracker)
        if scenario.touched is not None and files.touched is not None:
            write_points(scenario.touched, new / files.touched)
        if scenario.truth is not None:
            write_truth(scenario.truth, new / TRUTH)
        write_text(new / CONFIG, config_text(config))
        if notes is not None:
            _write_notes(scenario, new, notes)


def _write_notes(scenario: Scenario, folder: Path, notes: ScenarioNotes) -> None:
    write_text(folder / README, readme_text(scenario, notes))
    if notes.fixtures is not None:
        described = FixturesConfig.of(notes.fixtures).model_dump(mode="json", exclude_none=True)
        write_text(folder / FIXTURES, yaml_text(described, flow=None))
        for name, model in structure_files(notes.fixtures).items():
            write_model(model, folder / name)
    if notes.preview_png is not None:
        write_bytes(folder / PREVIEW, notes.preview_png)
    if notes.spec and scenario.truth is not None:
        write_text(folder / TRUTH / SPEC, notes.spec)
    if notes.examination is not None and scenario.truth is not None:
        write_json(folder / TRUTH / EXAMINATION, notes.examination)


def _config(scenario: Scenario) -> ScenarioConfig:
    preop, fan = scenario.preop, scenario.fan
    return ScenarioConfig(
        name=scenario.name,
        preset=scenario.preset,
        seed=None if scenario.seed is None else int(scenario.seed),
        patient_id=preop.patient_id,
        preop=ScenarioPreop(
            kind=_kind(preop),
            mr="preop/mr.nrrd" if preop.mr is not None else None,
            views=tuple(f"preop/view_{k}.nrrd" for k in range(len(preop.views))),
            labels=None if preop.labels is None and preop.ed_labels is None else "preop/labels.nrrd",
            surfaces=tuple(series.name for series in preop.surfaces),
            surface=preop.surface,
            label_names={int(value): name for value, name in preop.label_names},
            organ_labels=tuple(int(value) for value in preop.organ_labels),
        ),
        fan=None if fan is None else FanConfig.of(fan),
        files=FilesConfig(
            ecg=f"{TRIGGER_PREFIX}{TRIGGER}" if isinstance(scenario.ecg, TriggerTimes) else "ecg.csv",
            start="start.tfm" if scenario.start is not None else None,
            landmarks_mr="landmarks_mr.mrk.json" if scenario.landmarks_mr is not None else None,
            landmarks_tracker="landmarks_tracker.mrk.json"
            if scenario.landmarks_tracker is not None
            else None,
            touched="touched.csv" if scenario.touched is not None else None,
            **_breathing_files(scenario),
        ),
    )


def _breathing_files(scenario: Scenario) -> dict[str, str]:
    """Name the recordings of breathing, and the one that a session follows."""
    files, used = {}, scenario.respiration
    if scenario.chest is not None:
        files["chest"] = "chest.igs.mha"
        files["respiration"] = "marker:chest.igs.mha"
    if scenario.ventilator is not None and used is not None:
        files["ventilator"] = "ventilator.csv"
        files["respiration"] = f"csv:ventilator.csv#{used.name}"
    return files


def _kind(preop: Preop) -> Literal["labels", "surfaces", "labels and surfaces"]:
    labelled = preop.labels is not None or preop.ed_labels is not None
    if not labelled and not preop.surfaces:
        raise InvalidInputError("the scenario has neither a label image nor surfaces; it needs one of them")
    if preop.labels is None and preop.ed_labels is not None and (preop.mr is None or preop.ed_phase != 0):
        raise InvalidInputError(
            "labels of end-diastole alone go into a scenario folder with the cine that tells their motion, "
            "and end-diastole is its first phase"
        )
    if labelled and preop.surfaces:
        return "labels and surfaces"
    return "labels" if labelled else "surfaces"


def write_preop(preop: Preop, folder: Path, config: ScenarioPreop) -> None:
    """Write images, surfaces and times under the names of the configuration.

    Raises:
        OutputError: not writable.
    """
    timings: dict[str, CycleTiming] = {}
    if preop.mr is not None and config.mr is not None:
        write_volume_series(preop.mr, folder / config.mr)
        timings["mr"] = preop.mr.timing
    for k, (view, name) in enumerate(zip(preop.views, config.views, strict=True)):
        write_volume_series(view, folder / name)
        timings[f"view_{k}"] = view.timing
    if preop.labels is not None and config.labels is not None:
        write_volume_series(preop.labels, folder / config.labels)
        timings["labels"] = preop.labels.timing
    elif preop.ed_labels is not None and config.labels is not None:
        write_volume(preop.ed_labels, folder / config.labels)
    for series in preop.surfaces:
        write_surface_series(series, folder / config.surfaces_folder, timing=False)
        timings[series.name] = series.timing
    documents = {name: timing_document(timing) for name, timing in timings.items()}
    common = next(iter(documents.values()))
    others = {name: document for name, document in documents.items() if document != common}
    write_json(folder / config.timing, {**common, "series": others} if others else common)


def _write_nwire(recording: NWireRecording, folder: Path, files: FilesConfig) -> None:
    """The phantom is its own reference: poses are written as ProbeToReference, Phantom to Reference is 1."""
    probe = recording.phantom_from_probe
    phantom_poses = PoseStream(
        "reference", probe.source, probe.t_s, probe.rotations, probe.translations_mm, probe.valid
    )
    write_poses(phantom_poses, folder / files.nwire)
    placed = Rigid.identity("reference", "phantom")
    write_nwire_phantom(folder / files.nwire_device_set, recording.phantom, placed)
    write_wire_points(folder / files.nwire_points, "CalibrationData", recording.phantom, recording.points_px)


def _write_latency(recording: LatencyRecording, folder: Path, files: FilesConfig) -> None:
    write_poses(recording.tracker_from_probe, folder / files.latency_tracker)
    trace = recording.wall_row_px
    seen = np.ones(len(trace.t_s), dtype=np.bool_)
    write_sequence(TrackedSequence(trace.t_s, None, seen, {}), folder / files.latency_video)
    write_line_table(folder / files.latency_lines, trace.values)


def readme_text(scenario: Scenario, notes: ScenarioNotes) -> str:
    """Markdown for a person who opens the folder."""
    faults = notes.faults or ("None beyond ordinary noise, mild variability and short drop-outs.",)
    preview = "" if notes.preview_png is None else "`preview.png` shows it at a glance. "
    again = ["`truth/spec.yaml` makes this scenario again: `dvf-ig synth scenario --spec FILE -o DIR`.", ""]
    return "\n".join(
        [
            f"# {scenario.name}",
            "",
            f"A {'recorded' if scenario.truth is None else 'synthetic'} intervention, preset "
            f"`{scenario.preset}`. {preview}Replay it with `dvf-ig replay DIR -o RUN`.",
            "",
            "## Disturbances",
            "",
            *(f"- {fault}" for fault in faults),
            "",
            "## Files",
            "",
            "| file | content | frame | clock |",
            "|---|---|---|---|",
            *(f"| {' | '.join(row)} |" for row in (*_rows(scenario), *_fixture_rows(notes.fixtures))),
            "",
            *_CONVENTIONS,
            "",
            *(again if notes.spec and scenario.truth is not None else []),
        ]
    )


def _beat_source_row(source: Signal | TriggerTimes) -> tuple[str, str, str, str]:
    if isinstance(source, TriggerTimes):
        return (f"`{TRIGGER}`", f"{len(source)} pulses of a trigger in place of an ECG", "", "tracker")
    contents = f"{len(source) / source.rate_hz:.1f} s, {', '.join(source.leads)}, {source.unit}"
    return ("`ecg.csv`", contents, "", "tracker")


def _rows(scenario: Scenario) -> list[tuple[str, str, str, str]]:
    ecg, images = scenario.ecg, scenario.ultrasound
    tool_poses = len(scenario.tool or ()) + len(scenario.tool_after_restart or ())
    size = "" if images.images is None else f" of {images.images.shape[2]} × {images.images.shape[1]} px"
    rows = [
        ("`scenario.yaml`", "which file is what; the ultrasound fan in pixels", "", ""),
        *_preop_rows(scenario.preop),
        _beat_source_row(ecg),
        (
            "`ultrasound.igs.mha`",
            f"{len(images)} images{size}, with the pose looked up at each video stamp",
            "tracker_from_probe",
            "video",
        ),
        ("`tool.igs.mha`", f"{tool_poses} poses of the tool", "tracker_from_tool", "tracker"),
        (
            "`calibration/pivot.igs.mha`",
            "the tool turns about its resting tip",
            "tracker_from_tool",
            "tracker",
        ),
        ("`calibration/nwire*`", "N-wire sweep: poses, wires, segmented crossings", "phantom_from_probe", ""),
        ("`calibration/latency_tracker.igs.mha`", "water tank: poses", "tracker_from_probe", "tracker"),
        (
            "`calibration/latency_video.igs.mha`, `…_lines.xml`",
            "water tank: the floor's line",
            "image",
            "video",
        ),
    ]
    if scenario.start is not None:
        rows.append(("`start.tfm`", "coarse pose given by the operator", "mr_from_tracker", ""))
    if scenario.landmarks_mr is not None:
        rows.append(("`landmarks_mr.mrk.json`", "points on the pre-operative heart", "mr", ""))
    if scenario.landmarks_tracker is not None:
        rows.append(("`landmarks_tracker.mrk.json`", "the same points, touched", "tracker", ""))
    if scenario.touched is not None:
        rows.append(("`touched.csv`", "points touched on the surface at end-diastole", "tracker", ""))
    if scenario.ventilator is not None:
        channels = ", ".join(scenario.ventilator.leads)
        rows.append(("`ventilator.csv`", f"channels of the ventilator: {channels}", "", "tracker"))
    if scenario.chest is not None:
        rows.append(("`chest.igs.mha`", "poses of a marker on the chest", "tracker_from_chest", "tracker"))
    if scenario.truth is not None:
        rows.append(("`truth/`", "the ground truth; a replay reads it only to score itself", "", ""))
    return rows


def _fixture_rows(fixtures: FixtureSet | None) -> list[tuple[str, str, str, str]]:
    if fixtures is None:
        return []
    names = ", ".join(one.name for one in fixtures.fixtures)
    structures = [
        (f"`{name}`", f"model of the structure {model.surface_name}", model.frame, "")
        for name, model in structure_files(fixtures).items()
    ]
    return [(f"`{FIXTURES}`", f"what acts on the tool: {names}", "mr", ""), *structures]


def _preop_rows(preop: Preop) -> list[tuple[str, str, str, str]]:
    rows = []
    if preop.mr is not None:
        phases = len(preop.mr.timing)
        rows.append(("`preop/mr.nrrd`", f"pre-operative MR, {phases} phases of the cycle", "mr", ""))
    if preop.views:
        rows.append(("`preop/view_*.nrrd`", f"{len(preop.views)} long-axis cines", "mr", ""))
    if preop.labels is not None:
        rows.append(("`preop/labels.nrrd`", f"its {len(preop.label_names)} tissue labels", "mr", ""))
    rows += [
        (f"`preop/{s.name}_*.vtp`", f"surface, {len(s.timing)} phases", "mr", "") for s in preop.surfaces
    ]
    return rows


_CONVENTIONS = (
    "## Frames and clocks",
    "",
    "- All lengths are in mm, times in s; `mr` is LPS (left, posterior, superior are positive).",
    "- `target_from_source` maps coordinates of the source frame to the target frame. `image` is in pixels "
    "(column, row).",
    "- `tracker` is the tracking system's base, `probe` the sensor on the ultrasound probe, `tool` the one "
    "on the tool.",
    "- ECG and tracker share one clock. The video clock differs from it by a latency that the water-tank "
    "recording holds.",
)
