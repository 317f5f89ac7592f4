"""The README of a scenario folder: what is in it, in which frames, on which clocks; no ground truth."""

from dataclasses import dataclass

from dvf_ig.core.recordings.scenario import Preop, Scenario
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.intake.scenario.layout import TRIGGER


@dataclass(frozen=True, slots=True)
class ScenarioNotes:
    """What is known of a synthetic scenario beyond its recordings.

    Attributes:
        faults: one sentence each, without values of the ground truth.
        spec: YAML from which the scenario can be made again; it is written into truth/.
        preview_png: a picture of the scenario as a PNG file's bytes, see `dvf_ig.report.preview_png`.
    """

    faults: tuple[str, ...] = ()
    spec: str = ""
    preview_png: bytes | None = None


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
            *(f"| {' | '.join(row)} |" for row in _rows(scenario)),
            "",
            *_CONVENTIONS,
            "",
            *(again if notes.spec and scenario.truth is not None else []),
        ]
    )


def _beat_source_row(source: Signal | TriggerTimes) -> tuple[str, str, str, str]:
    if isinstance(source, TriggerTimes):
        return (f"`{TRIGGER}`", f"{len(source)} pulses of a trigger in place of an ECG", "", "tracker")
    told = f"{len(source) / source.rate_hz:.1f} s, {', '.join(source.leads)}, {source.unit}"
    return ("`ecg.csv`", told, "", "tracker")


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
    if scenario.truth is not None:
        rows.append(("`truth/`", "the ground truth; a replay reads it only to score itself", "", ""))
    return rows


def _preop_rows(preop: Preop) -> list[tuple[str, str, str, str]]:
    rows = []
    if preop.mr is not None:
        phases = len(preop.mr.timing)
        rows.append(("`preop/mr.nrrd`", f"pre-operative MR, {phases} phases of the cycle", "mr", ""))
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
