"""`dvf-ig synth scenario --world second`: an intervention of the world that is only for reports."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from dvf_ig.cli.shell import emit, progress, wrote
from dvf_ig.io.yaml_text import yaml_text

if TYPE_CHECKING:
    from data_synth import SecondWorldRecording, SecondWorldSpec

    from .spec import SpecFile

FAULTS = (
    "The second world: the heart has changed since the MR, contours are noisy, and images, tracker, "
    "calibrations and gates have errors that were drawn for this heart.",
)
_PRESETS: dict[str, Any] = {"calm": None, "ventilated": "ventilated", "breathing": "spontaneous"}
"""Kind of breathing by the preset's name."""
_KEYS = {
    *("schema_", "world", "preset", "quality", "heart", "motion", "seconds", "seed", "us_rate_hz"),
    "exam",
}


def second_scenario(file: "SpecFile", out: Path | None, *, print_spec: bool, as_json: bool) -> None:
    """Make, write and describe a scenario of the second world.

    Raises:
        typer.BadParameter: an option of the first world, or nowhere to write.
    """
    from data_synth import SecondWorldSpec, second_world_recording

    if file.world != "second":
        raise typer.BadParameter("--quality belongs to --world second; the first world takes --preset")
    default = type(file)()
    foreign = [key for key in type(file).model_fields if key not in _KEYS]
    if any(getattr(file, key) != getattr(default, key) for key in foreign) or file.preset not in _PRESETS:
        raise typer.BadParameter(
            "--world second takes --quality, --heart, --motion, --exam, --seconds, --seed, --us-rate-hz, and "
            "--preset ventilated or breathing"
        )
    motion: Any = file.motion  # checked there, like the kind of heart
    heart: Any = file.heart if "heart" in file.model_fields_set else "varied"
    quality = file.quality or "calm"
    spec = SecondWorldSpec(
        file.seed, quality, motion, file.seconds, file.us_rate_hz, heart, _PRESETS[file.preset], file.exam
    )
    if print_spec:
        print(_text(spec), end="")
        return
    if out is None:
        raise typer.BadParameter("give a folder to write with -o, or --print-spec")
    from dvf_ig.intake import ScenarioNotes, write_scenario
    from dvf_ig.report import preview_png

    with progress("scenario of the second world") as report:
        recorded = second_world_recording(spec, progress=report)
    exam = None if recorded.examined is None else recorded.examined.truth()
    notes = ScenarioNotes(FAULTS, _text(spec, recorded), preview_png(recorded.scenario), exam)
    write_scenario(recorded.scenario, out, notes)
    facts = _facts(recorded, out)
    emit(facts, [(key.replace("_", " "), str(value)) for key, value in facts.items()], as_json=as_json)
    wrote(out, "mr, tracker")


def _text(spec: "SecondWorldSpec", recorded: "SecondWorldRecording | None" = None) -> str:
    """Format YAML to make the scenario again, with the values drawn for a made one as comments."""
    fields = asdict(spec)
    breath = fields.pop("breathing")
    preset = next(name for name, kind in _PRESETS.items() if kind == breath)
    text = yaml_text({"schema": "dvf_ig.scenario-spec/1", "world": "second", "preset": preset, **fields})
    if recorded is None:
        return text
    floor = [f"#   {name}: {value:.4g}\n" for name, value in asdict(recorded.floor).items()]
    drawn = [f"#   {name}: {value:.5g}\n" for name, value in recorded.drawn.table().items()]
    head = f"# probe {recorded.probe}, sweep {recorded.sweep}\n# what no rigid registration can remove:\n"
    return text + head + "".join(floor) + "# drawn:\n" + "".join(drawn)


def _facts(recorded: "SecondWorldRecording", out: Path) -> dict[str, Any]:
    """Describe the scenario as JSON."""
    scenario = recorded.scenario
    return {
        "scenario": str(out),
        "name": scenario.name,
        "preset": scenario.preset,
        "patient_id": scenario.preop.patient_id,
        "seed": scenario.seed,
        "us_frames": len(scenario.ultrasound),
        "probe": recorded.probe,
        "sweep": recorded.sweep,
        "rigid_floor": asdict(recorded.floor),
    }
