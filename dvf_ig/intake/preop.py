"""The pre-operative heart of a session: a model, labels of one or every phase, or surfaces."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import (
    AnyArray,
    DvfModel,
    FloatArray,
    Preop,
    SurfaceSeries,
    UnreadableFileError,
    Volume,
    VolumeSeries,
)
from dvf_ig.core.timing.cycle import CycleTiming
from dvf_ig.io import dicom_patient_id, is_dicom_folder, read_cine_labels, read_json, read_model
from dvf_ig.io.image.timing import timing_from_document
from dvf_ig.io.image.volume import image_dimension, read_volume_series
from dvf_ig.io.mesh.series import UNKNOWN_PATIENT, read_surface_series, surface_names
from dvf_ig.io.reading import reading

from .problems import concerning
from .schema import PreopConfig

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class PreopFiles:
    """The pre-operative heart as read from its files.

    Attributes:
        model: if a file holds it.
        named_patient: whose surfaces they are by the names of their files; None if these do not say.
        patient_stated: whether the session says whose heart it is, and not the files alone.
    """

    preop: Preop
    model: DvfModel | None
    named_patient: str | None = None
    patient_stated: bool = True

    @property
    def of_anybody(self) -> bool:
        """Whether nothing but the name of its file says whose the model is."""
        return self.model is not None and not self.patient_stated and self.preop.mr is None


def read_preop(config: PreopConfig, folder: Path, patient_id: str | None) -> PreopFiles:
    """Read what the configuration names.

    Args:
        folder: where names of files begin.
        patient_id: whose heart; None takes the model's, else the name of the image or of the folder.
    Raises:
        UnreadableFileError: a file is absent or cannot be read.
        InvalidInputError: labels do not fit the image.
    """
    model = None
    if config.model is not None:
        with concerning("preop.model", path := folder / config.model):
            model = read_model(path, patient_id=patient_id)
    patient = patient_id or (model.patient_id if model is not None else _name(config, folder))
    with concerning("preop.timing"):
        timing = _Timing(None if config.timing is None else folder / config.timing)
    mr = None
    if config.mr is not None:
        with concerning("preop.mr", path := folder / config.mr):
            mr = timing.series(path, "mr")
    with concerning("preop.views"):
        views = tuple(timing.series(folder / name, f"view_{k}") for k, name in enumerate(config.views))
    if mr is not None and model is not None:
        mr = _with_times(mr, model, config.mr or "")
    labels, ed_labels = None, None
    if config.labels is not None:
        with concerning("preop.labels", path := folder / config.labels):
            if image_dimension(path) == 4:
                labels = timing.series(path, "labels")
            elif mr is None:
                raise UnreadableFileError(
                    f"{path} holds the labels of one phase; give mr, the cine that shows their motion"
                )
            else:
                ed_labels, _ = read_cine_labels(path, mr, config.ed_phase)
    with concerning("preop.surfaces_folder"):
        surfaces, named = _surfaces(config, folder, patient, timing)
    organ_labels = config.organ_labels or (label_values(labels) if labels is not None else ())
    preop = Preop(
        patient_id=patient,
        mr=mr,
        labels=labels,
        ed_labels=ed_labels,
        ed_phase=config.ed_phase,
        label_names=tuple(config.label_names.items()),
        organ_labels=organ_labels,
        cavity_labels=config.cavity_labels,
        surfaces=surfaces,
        surface=config.surface,
        views=views,
    )
    named = None if patient_id is None and model is None else named
    return PreopFiles(preop, model, named, patient_id is not None)


def _with_times(mr: VolumeSeries, model: DvfModel, name: str) -> VolumeSeries:
    """The series a model was made from has the times of the model's phases where it brings none itself."""
    if not mr.timing.timing_assumed:
        return mr
    if len(mr.timing) == model.phases:
        return replace(mr, timing=model.timing)
    log.warning(
        f"{name} has {len(mr.timing)} phases, the model {model.phases}: its phase i is taken to be at "
        f"i/{len(mr.timing)} of the cycle; put a timing.json beside it"
    )
    return mr


def label_values(labels: Volume | VolumeSeries) -> tuple[int, ...]:
    """Every value of a label image but the background's."""
    return tuple(int(value) for value in np.unique(labels.values) if value != 0)


def preop_label_values(preop: Preop) -> tuple[int, ...]:
    """The values in the label image, of every phase or of end-diastole, without 0."""
    labels = preop.labels if preop.labels is not None else preop.ed_labels
    return () if labels is None else label_values(labels)


def _name(config: PreopConfig, folder: Path) -> str:
    """Patient of the first file that images the heart: as DICOM images say, else its name without endings."""
    named = config.mr or config.labels or config.surfaces_folder or ""
    if is_dicom_folder(folder / named) and (patient := dicom_patient_id(folder / named)):
        return patient
    return Path(folder / named).name.partition(".")[0]


def _surfaces(
    config: PreopConfig, folder: Path, patient: str, timing: "_Timing"
) -> tuple[tuple[SurfaceSeries, ...], str | None]:
    """The surfaces as the patient's, and whose they are by the names of their files."""
    if config.surfaces_folder is None:
        return (), None
    path = folder / config.surfaces_folder
    names = config.surfaces or surface_names(path)
    series = [timing.surface(path, name) for name in names]
    named = {one.patient_id for one in series} - {UNKNOWN_PATIENT}
    return tuple(replace(one, patient_id=patient) for one in series), min(named, default=None)


class _Timing:
    """Phase times from one JSON file, which may list those of single series; without it, each file's own."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._document: Any = {} if path is None else read_json(path, "a timing file")

    def series(self, file: Path, role: str) -> VolumeSeries:
        """A 4-D image with the times of its role."""
        return read_volume_series(file, self._of(role) or self._path)

    def surface(self, folder: Path, name: str) -> SurfaceSeries:
        """A series of surfaces with the times of its name."""
        return read_surface_series(folder, name, self._of(name) or self._path)

    def _of(self, name: str) -> CycleTiming | None:
        """Its own times if the file lists it, else the common ones; None if the file is of another form."""
        document, path = self._document, self._path
        if path is None or not isinstance(document, dict) or "fractions" not in document:
            return None
        with reading(path, "a timing file"):
            return timing_from_document(path, document.get("series", {}).get(name, document))


def heart_surfaces(files: PreopFiles) -> Iterator[tuple[str, FloatArray]]:
    """(n, 3) points in mm of the heart at end-diastole, by the keys of the files that hold them."""
    preop, model = files.preop, files.model
    if model is not None:
        yield "preop.model", np.asarray(model.reference[model.ed_phase].vertices_mm)
    if preop.labels is not None or preop.ed_labels is not None:
        yield "preop.labels", _corners_of_labels(preop)
    fixture = [series for series in preop.surfaces if series.name == preop.surface]
    for series in fixture if model is None else ():
        yield "preop.surfaces_folder", np.asarray(series.vertices_mm[0])


def still_heart_key(files: PreopFiles) -> str | None:
    """Find the key of a heart that is the same in every phase; None if it beats, or is not read."""
    preop, model = files.preop, files.model
    if model is not None:
        return "preop.model" if model.still else None
    if preop.labels is not None:
        drawn = (
            np.isin(preop.labels.values, preop.organ_labels) if preop.organ_labels else preop.labels.values
        )
        return "preop.labels" if drawn.any() and _all_equal(drawn) else None
    fixture = next((series for series in preop.surfaces if series.name == preop.surface), None)
    return "preop.surfaces_folder" if fixture is not None and _all_equal(fixture.vertices_mm) else None


def _all_equal(phases: AnyArray) -> bool:
    """Whether every phase (p, ...) is the same as the first."""
    return all(np.array_equal(one, phases[0]) for one in phases[1:])


def heart_vertices(files: PreopFiles) -> Iterator[FloatArray]:
    """Vertices (n, 3) in mm of each surface of the heart at end-diastole.

    None where only labels show it, or where no slice shows a part of it, on which landmarks may lie.
    """
    model = files.model
    if model is not None:
        if model.seen is not None:
            return
        yield np.asarray(model.reference[model.ed_phase].vertices_mm)
        for chamber in model.chambers:
            yield np.asarray(chamber.surfaces[model.ed_phase].vertices_mm)
        return
    for series in files.preop.surfaces:
        yield np.asarray(series.vertices_mm[0])


def _corners_of_labels(preop: Preop) -> FloatArray:
    """(8, 3) corners of the box about the organ's voxels, in the axes of the image; (0, 3) without any."""
    of_cycle, of_phase = preop.labels, preop.ed_labels
    if of_cycle is not None:
        values, grid = of_cycle.values[preop.ed_phase % len(of_cycle.timing)], of_cycle.grid
    elif of_phase is not None:
        values, grid = of_phase.values, of_phase.grid
    else:
        return np.empty((0, 3))
    organ = np.isin(values, preop.organ_labels) if preop.organ_labels else values != 0
    sides = []
    for axis in range(3):
        there = np.flatnonzero(organ.any(axis=tuple(a for a in range(3) if a != axis)))
        if not len(there):
            return np.empty((0, 3))
        sides.append((there[0] - 0.5, there[-1] + 0.5))
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid.to_mm(corners)
