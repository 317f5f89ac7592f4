"""Building of a model from the source of a `BuildRequest`: surfaces, labels, or an image."""

from dataclasses import replace
from pathlib import Path

import typer

from dvf_ig.cli.shell import progress, warn
from dvf_ig.core import DvfModel, Preop

from .from_image import BuiltModel, model_from_image, warn_of_no_blood
from .request import BuildRequest


def model_of(request: BuildRequest, *, as_json: bool) -> BuiltModel:
    """Build the model, with its evidence if it is made from an image."""
    if request.image is not None:
        return model_from_image(request, request.image, as_json=as_json)
    if request.surfaces is not None and request.surfaces.is_file():
        return BuiltModel(_from_mesh(request, request.surfaces), {})
    if request.surfaces is not None:
        model = _from_surfaces(request, request.surfaces)
        if not model.chambers:
            warn_of_no_blood("put LV_ENDOCARDIAL or RV_ENDOCARDIAL in the same folder")
        return BuiltModel(model, {})
    if request.labels is not None:
        model = _from_labels(request, request.labels)
        if not model.chambers and not model.still:
            warn_of_no_blood("give --cavity")
        return BuiltModel(model, {})
    raise typer.BadParameter("give --surfaces DIR, --labels SERIES, or --image and labels or seeds")


def _from_surfaces(request: BuildRequest, folder: Path) -> DvfModel:
    from dvf_ig.io import read_surface_series, surface_names
    from dvf_ig.preop import CHAMBER_SURFACES, model_from_surfaces

    series = read_surface_series(folder, request.surface, request.timing)
    chambers = [n for n in surface_names(folder) if n in CHAMBER_SURFACES and n != request.surface]
    others = [read_surface_series(folder, name, request.timing) for name in chambers]
    if request.patient:
        series = replace(series, patient_id=request.patient)
    with progress("fitting phases") as report:
        return model_from_surfaces(
            series,
            others=others,
            options=request.model_options(),
            progress=report,
            sources=(f"{folder.name}: {request.surface}",),
        )


def _from_mesh(request: BuildRequest, file: Path) -> DvfModel:
    from dvf_ig.io import read_mesh
    from dvf_ig.preop import model_of_still

    mesh = read_mesh(file)
    with progress("fitting") as report:
        return model_of_still(
            mesh,
            patient_id=request.patient_id(file),
            surface_name=file.stem,
            options=request.model_options(),
            progress=report,
            sources=(file.name,),
        )


def _from_labels(request: BuildRequest, image: Path) -> DvfModel:
    from dvf_ig.io import image_dimension, read_label_names, read_labels, read_volume_series
    from dvf_ig.preop import model_from_labels, still_series

    still = image_dimension(image) == 3 or bool(read_label_names(image))
    if still:
        warn(
            f"{image} labels one phase, so {request.output.stem} does not beat; if it does, also give the "
            "4-D image whose motion carries it through the cycle: --image CINE"
        )
    preop = Preop(
        patient_id=request.patient_id(image),
        labels=still_series(*read_labels(image)) if still else read_volume_series(image, request.timing),
        organ_labels=request.organ,
        cavity_labels=request.cavity,
        surface=request.output.stem if still else request.surface,
    )
    source = f"{image.name}: labels {','.join(map(str, request.organ))}"
    with progress("fitting phases") as report:
        return model_from_labels(preop, options=request.model_options(), progress=report, sources=(source,))
