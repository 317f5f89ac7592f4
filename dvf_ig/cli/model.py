"""`dvf-ig model build|check`: from pre-operative surfaces or labels to the fixture's model file."""

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.core import DvfModel, OutputError, Preop

from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, warn, wrote

if TYPE_CHECKING:
    from dvf_ig.preop import ModelCheck, ModelOptions

app = typer.Typer(help="Build a dynamic fixture from pre-operative data, and check it.", no_args_is_help=True)


@app.command("build")
def build(
    output: Annotated[Path, typer.Option("-o", "--output", help="Model file to write (.npz).")],
    surfaces: Annotated[
        Path | None, typer.Option("--surfaces", help="Folder (or archive) of surfaces, one mesh a phase.")
    ] = None,
    surface: Annotated[str, typer.Option("--surface", help="Name of the surface to guard.")] = "EPICARDIAL",
    labels: Annotated[Path | None, typer.Option("--labels", help="4-D label image.")] = None,
    organ: Annotated[
        str | None, typer.Option("--organ", help="Label values inside the surface, for example 1,2,5.")
    ] = None,
    timing: Annotated[Path | None, typer.Option("--timing", help="JSON file of phase times and RR.")] = None,
    patient: Annotated[str | None, typer.Option("--patient", help="Patient id (for --labels).")] = None,
    knot_mm: Annotated[float, typer.Option("--knot-mm", help="Spline knot pitch in mm.")] = 3.0,
    margin_mm: Annotated[
        float, typer.Option("--margin-mm", help="Box margin around the heart in mm.")
    ] = 15.0,
    threads: ThreadsOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Fit signed-distance splines to a moving surface and write them as one model file."""
    with command(threads):
        if (surfaces is None) == (labels is None):
            raise typer.BadParameter("give either --surfaces DIR or --labels SERIES")
        if not output.parent.is_dir():
            raise OutputError(
                f"cannot write {output}: the folder {output.parent} does not exist; make it first"
            )
        from dvf_ig.io import write_model
        from dvf_ig.preop import ModelOptions

        options = ModelOptions(knot_mm, margin_mm, threads=threads or os.cpu_count() or 1)
        start = time.perf_counter()
        if surfaces is not None:
            model = _from_surfaces(surfaces, surface, timing, options)
        elif labels is not None:
            model = _from_labels(labels, organ, timing, patient, surface, options)
        seconds = time.perf_counter() - start
        _tell_assumptions(model)
        write_model(model, output)
        _report(model, seed, seconds, as_json)
        wrote(output, model.frame)


@app.command("check")
def check(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file.")],
    points: Annotated[int, typer.Option("--points", min=10, help="Random points on each phase.")] = 4000,
    threads: ThreadsOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Measure a model's error against the surfaces kept in it, at random points of their triangles."""
    with command(threads):
        from dvf_ig.io import read_model

        start = time.perf_counter()
        model = read_model(model_file)
        _tell_assumptions(model)
        _report(model, seed, None, as_json, points=points, start=start)


def _from_surfaces(folder: Path, name: str, timing: Path | None, options: "ModelOptions") -> DvfModel:
    from dvf_ig.core import LV_CAVITY
    from dvf_ig.io import read_surface_series, surface_names
    from dvf_ig.preop import model_from_surfaces

    series = read_surface_series(folder, name, timing)
    has_cavity = LV_CAVITY in surface_names(folder)
    cavity = read_surface_series(folder, LV_CAVITY, timing) if has_cavity else None
    with progress("fitting phases") as report:
        return model_from_surfaces(
            series, cavity=cavity, options=options, progress=report, sources=(f"{folder.name}: {name}",)
        )


def _from_labels(
    image: Path,
    organ: str | None,
    timing: Path | None,
    patient: str | None,
    name: str,
    options: "ModelOptions",
) -> DvfModel:
    from dvf_ig.io import read_volume_series
    from dvf_ig.preop import model_from_labels

    organ_labels = _organ_labels(organ)
    series = read_volume_series(image, timing)
    preop = Preop(
        patient_id=patient or image.name.split(".")[0],
        labels=series,
        organ_labels=organ_labels,
        surface=name,
    )
    with progress("fitting phases") as report:
        source = f"{image.name}: labels {','.join(map(str, organ_labels))}"
        return model_from_labels(preop, options=options, progress=report, sources=(source,))


def _organ_labels(text: str | None) -> tuple[int, ...]:
    if text is None:
        raise typer.BadParameter("--labels needs --organ, the label values inside the surface, e.g. 1,2,5")
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError as exc:
        raise typer.BadParameter(f"--organ is '{text}'; needed whole numbers such as 1,2,5") from exc


def _tell_assumptions(model: DvfModel) -> None:
    if model.timing.timing_assumed:
        warn(f"phase times are assumed: phase i at i/{model.phases} of the cycle; give --timing")
    if model.timing.rr_assumed:
        warn(f"the RR interval is assumed: {model.timing.rr_s:g} s")


def _report(
    model: DvfModel,
    seed: int,
    seconds: float | None,
    as_json: bool,
    *,
    points: int = 4000,
    start: float | None = None,
) -> None:
    """Check the model and print what both commands print."""
    import numpy as np

    from dvf_ig.preop import check_model

    result = check_model(model, points_per_phase=points, rng=np.random.default_rng(seed))
    if seconds is None and start is not None:
        seconds = time.perf_counter() - start
    emit(_payload(model, result, seed, seconds), _rows(model, result, seconds), as_json=as_json)


def _payload(model: DvfModel, result: "ModelCheck", seed: int, seconds: float | None) -> dict[str, Any]:
    from dvf_ig.preop import border_distance_mm, potential_at_border

    border_mm = border_distance_mm(model)
    return {
        "surface_error_mm": {
            "mean": result.mean_mm,
            "p99": result.p99_mm,
            "max": result.max_mm,
            "per_phase": result.per_phase_mm.tolist(),
        },
        "megabytes": model.megabytes,
        "phases": model.phases,
        "seconds": seconds,
        "patient_id": model.patient_id,
        "surface": model.surface_name,
        "frame": model.frame,
        "rr_s": model.timing.rr_s,
        "rr_assumed": model.timing.rr_assumed,
        "timing_assumed": model.timing.timing_assumed,
        "ed_phase": model.ed_phase,
        "es_fraction": model.es_fraction,
        "border_distance_mm": border_mm,
        "potential_at_border": potential_at_border(border_mm, 1.0),
        "points": result.points,
        "excluded_area_share": result.excluded_area_share,
        "rim_mm": result.rim_mm,
        "seed": seed,
    }


def _rows(model: DvfModel, result: "ModelCheck", seconds: float | None) -> list[tuple[str, str]]:
    from dvf_ig.preop import border_distance_mm, potential_at_border

    border_mm = border_distance_mm(model)
    extent = (model.upper_mm - model.origin_mm).round(0).astype(int).tolist()
    return [
        ("model", f"{model.surface_name} of {model.patient_id}, frame {model.frame}"),
        ("phases", f"{model.phases}, RR {model.timing.rr_s:.3f} s, end-systole at {model.es_fraction:.2f}"),
        ("box", f"{extent[0]} x {extent[1]} x {extent[2]} mm, knots every {model.knot_spacing_mm:g} mm"),
        (
            "border",
            f"{border_mm:.1f} mm off the surface at the nearest: a sigmoid of 1/mm has fallen to "
            f"{potential_at_border(border_mm, 1.0):.0e} of its cap",
        ),
        ("size", f"{model.megabytes:.1f} MB"),
        (
            "surface error",
            f"{result.mean_mm:.3f} mm mean, {result.p99_mm:.3f} p99, {result.max_mm:.3f} max "
            f"({result.points} random points)",
        ),
        (
            "not judged",
            f"{result.excluded_area_share:.0%} of the area: caps and {result.rim_mm:g} mm around them",
        ),
        ("time", f"{seconds:.1f} s" if seconds is not None else "-"),
    ]
