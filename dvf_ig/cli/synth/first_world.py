"""`dvf-ig synth scenario --world first`: a phantom, real surfaces or a real cine, with faults."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from dvf_ig.cli.shell import emit, progress, warn, wrote

if TYPE_CHECKING:
    from data_synth import ReplayedPath, ScenarioSpec
    from dvf_ig.core import Scenario, Volume, VolumeSeries
    from dvf_ig.guidance import FixtureSet

    from .spec import SpecFile

SURFACES = ("EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
"""Surfaces read from --surfaces; all except the first are optional."""


def first_scenario(file: "SpecFile", out: Path | None, *, print_spec: bool, as_json: bool) -> None:
    """Make, write and describe a scenario of the first world.

    Raises:
        typer.BadParameter: options that do not belong together, or nowhere to write.
    """
    from data_synth import describe_faults, scenario_examination
    from dvf_ig.intake import ScenarioNotes, write_scenario
    from dvf_ig.report import preview_png

    from .spec import scenario_spec, spec_text

    spec = scenario_spec(file)
    if print_spec:
        print(spec_text(file), end="")
        return
    if out is None:
        raise typer.BadParameter("give a folder to write with -o, or --print-spec")
    recorded, path = _made(file, spec)
    exam = scenario_examination(spec)
    notes = ScenarioNotes(
        describe_faults(spec.options),
        spec_text(file),
        preview_png(recorded),
        None if exam is None else exam.truth(),
        _fixtures(recorded, spec),
    )
    write_scenario(recorded, out, notes)
    emit(_facts(recorded, out, path), _rows(recorded, path), as_json=as_json)
    wrote(out, "mr, tracker")


def _fixtures(recorded: "Scenario", spec: "ScenarioSpec") -> "FixtureSet | None":
    """Build the fixtures of a preset that has its own."""
    if spec.preset != "atrial" or recorded.truth is None:
        return None
    from data_synth import preoperative_surface
    from dvf_ig.study.operators.lesion import scenario_fixtures

    return scenario_fixtures(recorded.truth.tool, preoperative_surface(spec, recorded.preop))


def _made(file: "SpecFile", spec: "ScenarioSpec") -> "tuple[Scenario, ReplayedPath | None]":
    from data_synth import phantom_scenario

    inputs, images = (
        (file.surfaces, file.ecg, file.probe_path),
        (file.cine, file.labels, file.es_labels, file.voxel_mm),
    )
    if file.anatomy != "surfaces" and any(value is not None for value in inputs):
        raise typer.BadParameter("--surfaces, --ecg and --probe-path belong to --anatomy surfaces")
    if file.anatomy != "cine" and any(value is not None for value in images):
        raise typer.BadParameter("--cine, --labels, --es-labels and --voxel-mm belong to --anatomy cine")
    if spec.preset == "atrial" and file.anatomy != "phantom":
        raise typer.BadParameter("--preset atrial belongs to --anatomy phantom")
    if file.anatomy == "phantom":
        with progress("synthetic scenario") as report:
            return phantom_scenario(spec, report), None
    if file.anatomy == "cine":
        if file.cine is None or file.labels is None:
            raise typer.BadParameter("--anatomy cine needs --cine and --labels")
        return _on_a_cine(spec, Path(file.cine), Path(file.labels), file), None
    surfaces, ecg, probe_path = inputs
    if surfaces is None or ecg is None or probe_path is None:
        raise typer.BadParameter("--anatomy surfaces needs --surfaces, --ecg and --probe-path")
    return _on_real_anatomy(spec, Path(surfaces), ecg, Path(probe_path))


def _on_a_cine(spec: "ScenarioSpec", cine: Path, labels: Path, file: "SpecFile") -> "Scenario":
    """Record a scenario on real MR and its expert's labels, with simulated ultrasound."""
    from dataclasses import replace

    from data_synth import CineHeart, cine_scenario, require_heart_size
    from dvf_ig.core import Volume
    from dvf_ig.io import read_cine_labels, read_volume_series
    from dvf_ig.preop import with_voxel_size

    drawn = None if file.es_labels is None else _named_systole(file.es_labels)
    series = read_volume_series(cine)
    ed, _ = read_cine_labels(labels, series, 0)
    systole = None if drawn is None else _drawn_systole(series, cine, *drawn)
    if file.voxel_mm is not None:
        grid = with_voxel_size(series.grid, file.voxel_mm)
        series, ed = replace(series, grid=grid), Volume(grid, ed.values)
    require_heart_size(series.grid, ed.values)
    es, phase = _tracked_systole(series, ed) if systole is None else systole
    heart = CineHeart(cine.resolve().parent.name, series, ed, Volume(series.grid, es.values), phase)
    with progress("synthetic scenario") as report:
        return cine_scenario(spec, heart, report)


def _named_systole(es_labels: str) -> tuple[Path, int]:
    """Parse file and phase of FILE@PHASE."""
    from dvf_ig.core import InvalidInputError

    name, _, phase = es_labels.rpartition("@")
    if not name or not phase.isdecimal():
        raise InvalidInputError(f"--es-labels is '{es_labels}'; needed FILE@PHASE, the first phase being 0")
    return Path(name), int(phase)


def _drawn_systole(series: "VolumeSeries", cine: Path, labels: Path, phase: int) -> "tuple[Volume, int]":
    """Read the expert's end-systole, and its phase."""
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_cine_labels

    if phase >= len(series.timing):
        raise InvalidInputError(f"{cine} has phases 0 to {len(series.timing) - 1}; --es-labels names {phase}")
    return read_cine_labels(labels, series, phase)[0], phase


def _tracked_systole(series: "VolumeSeries", ed: "Volume") -> "tuple[Volume, int]":
    """Find end-systole by the motion in the cine: the phase with the smallest left ventricle."""
    import numpy as np

    from data_synth import LV_LABEL, RV_LABEL
    from dvf_ig.core import Volume
    from dvf_ig.preop import cavity_volumes_mm3, propagate_labels, track_cycle

    values = np.asarray(ed.values)
    with progress("motion of the cine") as report:
        motion = track_cycle(series, values > 0, blood=np.isin(values, (RV_LABEL, LV_LABEL)), progress=report)
    phase = 1 + int(np.argmin(cavity_volumes_mm3(motion, values == LV_LABEL)[1:]))
    warn(
        f"the simulated heart moves as this program tracks the cine, with end-systole at phase {phase}; give "
        "--es-labels FILE@PHASE for a motion that is independent of it"
    )
    return Volume(series.grid, propagate_labels(motion, series, ed, phase)), phase


def _on_real_anatomy(
    spec: "ScenarioSpec", surfaces: Path, ecg: str, probe_path: Path
) -> "tuple[Scenario, ReplayedPath]":
    """Read the real recordings and simulate the ultrasound between them."""
    from data_synth import replayed_path, surface_scenario
    from dvf_ig.io import read_annotations, read_ecg, read_sequence, read_surface_series, surface_names

    beats_s = read_annotations(ecg).t_s
    signal = read_ecg(ecg)
    sequence = read_sequence(probe_path)
    fixed = "reference" if any("reference" in name for name in sequence.poses) else "tracker"
    path = replayed_path(sequence.stream(fixed, "probe"))
    present = surface_names(surfaces)
    series = {
        name: read_surface_series(surfaces, name=name)
        for name in SURFACES
        if name == SURFACES[0] or name in present
    }
    with progress("synthetic scenario") as report:
        return surface_scenario(spec, series, signal, beats_s, path, report), path


def _facts(recorded: "Scenario", out: Path, path: "ReplayedPath | None") -> dict[str, Any]:
    """Describe the scenario as JSON."""
    from dvf_ig.core import Signal

    truth, ecg = recorded.truth, recorded.ecg
    facts: dict[str, Any] = {
        "scenario": str(out),
        "name": recorded.name,
        "preset": recorded.preset,
        "patient_id": recorded.preop.patient_id,
        "seed": recorded.seed,
        "us_frames": len(recorded.ultrasound),
        "ecg_seconds": len(ecg) / ecg.rate_hz if isinstance(ecg, Signal) else float(ecg.t_s[-1]),
        "preop_phases": len((recorded.preop.mr or recorded.preop.surfaces[0]).timing),
    }
    if truth is not None:
        facts["beats"] = len(truth.r_peaks_s)
        facts["mismatch_mm"] = truth.mismatch_mm
        facts["contact_share"] = float((truth.tool.distance_mm >= 0).mean())
        facts["deepest_mm"] = float(truth.tool.distance_mm.max())
    if path is not None:
        facts["probe_path"] = {"extent_mm": path.extent_mm, "extent_deg": path.extent_deg}
    return facts


def _rows(recorded: "Scenario", path: "ReplayedPath | None") -> list[tuple[str, str]]:
    """Describe the scenario as a table."""
    facts = _facts(recorded, Path(), path)
    rows = [
        ("scenario", recorded.name),
        ("patient", recorded.preop.patient_id),
        ("pre-operative phases", str(facts["preop_phases"])),
        ("ECG", f"{facts['ecg_seconds']:.1f} s"),
        ("ultrasound", f"{facts['us_frames']} frames"),
    ]
    if recorded.truth is not None:
        touching = f"{100 * facts['contact_share']:.0f} %, deepest {facts['deepest_mm']:.2f} mm"
        rows += [
            ("true beats", str(facts["beats"])),
            ("anatomy mismatch", f"{facts['mismatch_mm']:.2f} mm RMS"),
            ("tool in contact", touching),
        ]
    if path is not None:
        extent = f"{path.extent_mm:.1f} mm and {path.extent_deg:.1f}°, {path.t_s[-1]:.1f} s one way"
        rows.append(("recorded probe path", extent))
    return rows
