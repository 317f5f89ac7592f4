"""`dvf-ig model build|check|export`: from pre-operative data to the fixture's model file."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from dvf_ig.cli import shell

from .output import file_megabytes, model_payload, model_rows, phase_rows

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.preop import ModelCheck

    from .request import BuildRequest
from dvf_ig.cli.shell import JsonFlag, command, emit, out_folder, wrote

OutputOption = Annotated[Path, shell.out_file("Model file to write (.npz).")]
MarginOption = Annotated[float, Option("--margin-mm", help="Box margin around the heart in mm.")]
LABELS_HELP = (
    "A label image and its position in the model's cycle. PHASE with a decimal point is a fraction of the "
    "cycle in [0, 1), a whole number one of the model's phases, counted from 0: es.nii.gz@0.35, "
    "es.seg.nrrd@11. For a 4-D image it selects the frame."
)


CHECK_POINTS = 4000
"""Number of random points on each phase at which a model is checked."""

app = typer.Typer(
    help="Build a dynamic fixture from pre-operative data, check it, export its surface.",
    no_args_is_help=True,
)


@app.command("build")
def build(
    output: OutputOption,
    surfaces: Annotated[
        Path | None,
        Option(
            help="Folder (or archive) of surfaces, one mesh a phase; or one mesh file, of a structure "
            "that does not beat (an oesophagus, a nerve)."
        ),
    ] = None,
    surface: Annotated[str, Option(help="Name of the surface to guard.")] = "EPICARDIAL",
    labels: Annotated[
        Path | None,
        Option(
            help="4-D label image; with --image, a 3-D one of end-diastole is enough (also .seg.nrrd). A "
            "3-D one alone: of a structure that does not beat."
        ),
    ] = None,
    image: Annotated[Path | None, Option(help="4-D image, for the motion of --labels or --seeds.")] = None,
    dicom: Annotated[
        Path | None,
        Option(
            help="Folder of an examination with all its series: short-axis stack and long-axis cines are "
            "found by their geometry; the rest is left out with a reason."
        ),
    ] = None,
    sax: Annotated[
        Path | None, Option(help="Short-axis 4-D stack, as --image, which --lax goes with.")
    ] = None,
    lax: Annotated[
        list[Path] | None,
        Option(help="Long-axis cine of one slice, with --sax or --image; once for each view."),
    ] = None,
    seeds: Annotated[
        Path | None,
        Option(
            help="Points named heart, cavity, background, any number of each name (.mrk.json, .fcsv, JSON)."
        ),
    ] = None,
    cavity: Annotated[
        str | None,
        Option(
            help="Label values of blood, the left ventricle's first, for example 3,1: end-systole is the "
            "phase in which the first is smallest; ultrasound shows the boundaries of all (default: those "
            "that .seg.nrrd names so)."
        ),
    ] = None,
    ed_phase: Annotated[int, Option(min=0, help="With --image: the phase that is labelled.")] = 0,
    motion: Annotated[str, Option(help="With --image: bspline or demons.")] = "bspline",
    organ: Annotated[
        str | None,
        Option(
            help="Label values inside the surface, for example 1,2,5 (default with --image: all except 0)."
        ),
    ] = None,
    timing: Annotated[
        Path | None,
        Option(
            help='JSON file of phase times and RR: {"fractions": [0.0, 0.05, ...], "rr_s": 0.86} (default: '
            "timing.json next to the image)."
        ),
    ] = None,
    patient: Annotated[str | None, Option(help="Patient id (default: from the file's name).")] = None,
    voxel_mm: shell.VoxelOption = None,
    knot_mm: Annotated[float | None, Option(help="Spline knot pitch in mm (default 3).")] = None,
    accuracy_mm: Annotated[
        float | None,
        Option(
            help="Required mean surface error in mm (p99: four times that): the coarsest knots that reach it "
            "on the most contracted phase."
        ),
    ] = None,
    margin_mm: MarginOption = 15.0,
    threads: shell.ThreadsOption = None,
    seed: shell.SeedOption = 0,
    as_json: shell.JsonFlag = False,
) -> None:
    """Fit signed-distance splines to a moving surface and write them as one model file."""
    with shell.command(threads):
        from .request import BuildRequest

        request = BuildRequest(
            output=output,
            surfaces=surfaces,
            labels=labels,
            image=_one_image(image, sax, dicom),
            examination=dicom is not None,
            views=tuple(lax or ()),
            seeds=seeds,
            surface=surface,
            organ=_labels(organ, "--organ"),
            cavity=_labels(cavity, "--cavity"),
            ed_phase=ed_phase,
            method=motion,
            timing=timing,
            patient=patient,
            knot_mm=knot_mm,
            accuracy_mm=accuracy_mm,
            margin_mm=margin_mm,
            threads=shell.cores_or(threads),
            seed=seed,
            voxel_mm=shell.voxel_size(voxel_mm),
        )
        _build(request, as_json=as_json)


def _one_image(image: Path | None, sax: Path | None, dicom: Path | None) -> Path | None:
    """Return the 4-D image, which has three spellings."""
    if sum(path is not None for path in (image, sax, dicom)) > 1:
        raise typer.BadParameter("--image, --sax and --dicom all name the 4-D image; give one of them")
    return image or sax or dicom


def _labels(text: str | None, option: str) -> tuple[int, ...]:
    return shell.whole_numbers(text, option, "1,2,5") if text else ()


def _build(request: "BuildRequest", *, as_json: bool) -> None:
    """Build, check, write and print the model."""
    from dvf_ig.io import files_together, write_model

    from .sources import model_of

    start, output = time.perf_counter(), request.output
    built = model_of(request, as_json=as_json)
    model, evidence = built.model, built.evidence
    seconds = time.perf_counter() - start
    _warn_of_assumptions(model)
    result = _errors(model, CHECK_POINTS, request.seed)
    paths = (output, *built.replaced, *(file.path for file in built.beside))
    with files_together(output.parent, [path.name for path in paths]) as new:
        for file in built.beside:
            file.write(new / file.path.name)
        write_model(model, new / output.name)
    size_mb = file_megabytes(output)
    payload = {**model_payload(model, result, request.seed, seconds, size_mb), **evidence}
    rows = model_rows(model, result, seconds, size_mb, evidence.get("anatomical_error_mm"))
    shell.emit(payload, rows, as_json=as_json)
    for file in built.beside:
        shell.wrote(file.path, file.frame)
    shell.wrote(output, model.frame)


@app.command("check")
def check(
    model_file: Annotated[Path, Argument(metavar="MODEL", help="Model file.")],
    points: Annotated[int, Option(min=10, help="Random points on each phase.")] = CHECK_POINTS,
    labels: Annotated[str | None, Option(help=LABELS_HELP, metavar="FILE@PHASE")] = None,
    surfaces: Annotated[
        Path | None, Option(help="Folder of surfaces of the same heart by another method: distances.")
    ] = None,
    organ: Annotated[
        str | None,
        Option(
            help="With --labels: label values inside the surface, for example 1,2,5 (default: all except 0)."
        ),
    ] = None,
    cavity: Annotated[
        str | None,
        Option(
            help="With --labels: label values of blood as the model was built with, whose walls are added "
            "where the labels lack them."
        ),
    ] = None,
    voxel_mm: shell.VoxelOption = None,
    threads: shell.ThreadsOption = None,
    seed: shell.SeedOption = 0,
    as_json: shell.JsonFlag = False,
) -> None:
    """Measure a model's spline fit error, at random points of the surfaces kept in it.

    This describes how well the splines fit those surfaces, not how well these describe the patient's anatomy,
    which --labels measures with labels of a phase that the model was not built from, and --surfaces with
    surfaces that something else fitted to the same images.
    """
    from .labels import check_with_labels, check_with_surfaces, labels_at

    given_labels = labels_at(labels) if labels is not None else None
    organs, cavities = _labels(organ, "--organ"), _labels(cavity, "--cavity")
    if (organs or cavities) and given_labels is None:
        named = "--organ" if organs else "--cavity"
        raise typer.BadParameter(f"{named} needs --labels, the label image that it belongs to")
    with shell.command(threads):
        from dvf_ig.io import read_model

        start = time.perf_counter()
        model = read_model(model_file)
        _warn_of_assumptions(model)
        result = _errors(model, points, seed)
        seconds = time.perf_counter() - start
        size_mb = file_megabytes(model_file)
        rows = model_rows(model, result, seconds, size_mb) + phase_rows(model, result)
        payload = model_payload(model, result, seed, seconds, size_mb)
        if given_labels is not None:
            payload["labels"], label_rows = check_with_labels(
                model, given_labels, organs, cavities, points, seed, shell.voxel_size(voxel_mm)
            )
            rows += label_rows
        if surfaces is not None:
            payload["surfaces"], surface_rows = check_with_surfaces(model, surfaces, points, seed)
            rows += surface_rows
        shell.emit(payload, rows, as_json=as_json)


def _errors(model: "DvfModel", points: int, seed: int) -> "ModelCheck":
    import numpy as np

    from dvf_ig.preop import check_model

    return check_model(model, points_per_phase=points, rng=np.random.default_rng(seed))


def _warn_of_assumptions(model: "DvfModel") -> None:
    if model.timing.timing_assumed:
        shell.warn(
            f"phase times are assumed: phase i at i/{model.phases} of the cycle; give the measured ones with "
            "--timing FILE, or in a timing.json next to the image"
        )
    if model.timing.rr_assumed:
        shell.warn(f"the RR interval is assumed: {model.timing.rr_s:g} s")


CONTENT = {"vtp": "surface", "stl": "surface", "nrrd": "signed distance in mm, positive inside"}


@app.command("export")
def export(
    model_file: Annotated[Path, Argument(metavar="MODEL", help="Model file.")],
    out: Annotated[Path, out_folder("Folder to write into.")],
    form: Annotated[
        Literal["vtp", "stl", "nrrd"],
        Option(
            "--format",
            help="Surface: vtp (every digit) or stl (32-bit floats). nrrd: image of the signed distance.",
        ),
    ] = "vtp",
    as_json: JsonFlag = False,
) -> None:
    """Write the surface that the model was fitted to, or its distance: mm, LPS (tagged so for 3D Slicer).

    One file a phase. Where slices show a part of the surface only, VTP files flag the cells of the rest as
    "unseen". The distance is that of the splines, on every half knot of the model's box.
    """
    with command():
        from dvf_ig.io import files_together, output_folder, read_model

        model = read_model(model_file)
        with output_folder(out), files_together(out) as new:
            kind = "_distance" if form == "nrrd" else ""
            files = [out / f"{model.surface_name}{kind}_{i:03d}.{form}" for i in range(model.phases)]
            for phase, path in enumerate(files):
                _write_phase(model, phase, new / path.name, form)
        for path in files:
            wrote(path, model.frame)
        result = {
            "files": [path.name for path in files],
            "content": CONTENT[form],
            "phase_fractions": list(model.timing.fractions),
            "surface": model.surface_name,
            "patient_id": model.patient_id,
            "frame": model.frame,
            "space": "LPS",
        }
        rows = [
            (path.name, f"phase {i}, at {fraction:.3f} RR")
            for i, (path, fraction) in enumerate(zip(files, model.timing.fractions, strict=True))
        ]
        emit(result, rows, as_json=as_json)


def _write_phase(model: "DvfModel", phase: int, path: Path, form: str) -> None:
    from dvf_ig.io import write_mesh, write_volume
    from dvf_ig.preop import distance_volume

    if form == "nrrd":
        write_volume(distance_volume(model, phase), path)
    else:
        flags = {} if model.seen is None else {"unseen": model.unseen(phase)}
        write_mesh(model.reference[phase], path, flags)
