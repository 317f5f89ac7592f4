"""`dvf-ig model build|check`: from pre-operative surfaces or labels to the fixture's model file."""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, warn, wrote
from dvf_ig.core import DvfModel, OutputError, Preop

from .from_image import ImageRequest, model_from_image
from .output import model_payload, model_rows, phase_rows

if TYPE_CHECKING:
    from dvf_ig.preop import ModelOptions

app = typer.Typer(help="Build a dynamic fixture from pre-operative data, and check it.", no_args_is_help=True)


@app.command("build")
def build(
    output: Annotated[Path, typer.Option("-o", "--out", help="Model file to write (.npz).")],
    surfaces: Annotated[
        Path | None, typer.Option("--surfaces", help="Folder (or archive) of surfaces, one mesh a phase.")
    ] = None,
    surface: Annotated[str, typer.Option("--surface", help="Name of the surface to guard.")] = "EPICARDIAL",
    labels: Annotated[
        Path | None, typer.Option("--labels", help="4-D label image; with --image, end-diastole's.")
    ] = None,
    image: Annotated[
        Path | None, typer.Option("--image", help="4-D image, for the motion of --labels or --seeds.")
    ] = None,
    seeds: Annotated[
        Path | None, typer.Option("--seeds", help="Points named heart, cavity, background (.mrk.json, JSON).")
    ] = None,
    cavity: Annotated[
        str | None, typer.Option("--cavity", help="With --image: label values of the left ventricle's blood.")
    ] = None,
    ed_phase: Annotated[
        int, typer.Option("--ed-phase", min=0, help="With --image: the phase that is labelled.")
    ] = 0,
    motion: Annotated[str, typer.Option("--motion", help="With --image: bspline or demons.")] = "bspline",
    organ: Annotated[
        str | None, typer.Option("--organ", help="Label values inside the surface, for example 1,2,5.")
    ] = None,
    timing: Annotated[Path | None, typer.Option("--timing", help="JSON file of phase times and RR.")] = None,
    patient: Annotated[str | None, typer.Option("--patient", help="Patient id (for --labels).")] = None,
    knot_mm: Annotated[
        float | None, typer.Option("--knot-mm", help="Spline knot pitch in mm (default 3).")
    ] = None,
    accuracy_mm: Annotated[
        float | None,
        typer.Option(
            "--accuracy-mm",
            help="Wanted mean surface error in mm (p99: four times that): the coarsest knots that reach it "
            "on the most contracted phase.",
        ),
    ] = None,
    margin_mm: Annotated[
        float, typer.Option("--margin-mm", help="Box margin around the heart in mm.")
    ] = 15.0,
    threads: ThreadsOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Fit signed-distance splines to a moving surface and write them as one model file."""
    with command(threads):
        if (surfaces is None) == (labels is None and image is None):
            raise typer.BadParameter("give --surfaces DIR, --labels SERIES, or --image and labels or seeds")
        if image is None and seeds is not None:
            raise typer.BadParameter("--seeds needs --image, the 4-D image that they are set in")
        if not output.parent.is_dir():
            raise OutputError(
                f"cannot write {output}: the folder {output.parent} does not exist; make it first"
            )
        if knot_mm is not None and accuracy_mm is not None:
            raise typer.BadParameter("give either --knot-mm or --accuracy-mm")
        from dvf_ig.io import write_model
        from dvf_ig.preop import ModelOptions

        options = ModelOptions(
            knot_mm or ModelOptions().knot_spacing_mm,
            margin_mm,
            threads=threads or os.cpu_count() or 1,
            accuracy_mm=accuracy_mm,
        )
        start = time.perf_counter()
        evidence: dict[str, Any] = {}
        if image is not None:
            request = ImageRequest(
                image,
                labels,
                seeds,
                _organ_labels(organ) if organ else (),
                _organ_labels(cavity) if cavity else (),
                ed_phase,
                motion,
                timing,
                patient,
                surface,
                output,
            )
            model, evidence["motion"] = model_from_image(request, options, as_json=as_json)
        elif surfaces is not None:
            model = _from_surfaces(surfaces, surface, timing, options)
        elif labels is not None:
            model = _from_labels(labels, organ, timing, patient, surface, options)
        seconds = time.perf_counter() - start
        _tell_assumptions(model)
        write_model(model, output)
        _report(model, seed, seconds, as_json, evidence=evidence)
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
        _report(model, seed, None, as_json, points=points, start=start, per_phase=True)


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
    per_phase: bool = False,
    evidence: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Check the model and print what both commands print."""
    import numpy as np

    from dvf_ig.preop import check_model

    result = check_model(model, points_per_phase=points, rng=np.random.default_rng(seed))
    if seconds is None and start is not None:
        seconds = time.perf_counter() - start
    rows = model_rows(model, result, seconds)
    if per_phase:
        rows += phase_rows(model, result)
    emit({**model_payload(model, result, seed, seconds), **evidence}, rows, as_json=as_json)
