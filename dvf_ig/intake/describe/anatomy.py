"""Facts about images, meshes, models, landmarks and transforms, for `describe`."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, DvfModel, Grid, InvalidInputError, Landmarks, Mesh, UnreadableFileError
from dvf_ig.core.plausible import surface_problem
from dvf_ig.core.timing.cycle import CycleTiming
from dvf_ig.io import read_dicom_examination, read_label_names, read_labels, read_landmarks, read_tag_pair
from dvf_ig.io.dicom.cine import read_dicom_cine
from dvf_ig.io.image.volume import image_dimension, read_array, read_volume, series_timing
from dvf_ig.io.itk_transform import linear_matrix
from dvf_ig.io.mesh.file import read_mesh
from dvf_ig.io.mesh.series import read_surface_series, surface_names
from dvf_ig.io.model.model_file import model_digest, read_model
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import rigid_from_matrix, sidecar_frames

log = logging.getLogger(__name__)

Facts = dict[str, Any]

MOST_LABELS = 32
"""An integer image with no more distinct values than this is shown as labels."""


def image_facts(path: Path) -> Facts:
    """Summarise size, geometry, pixel type and range of a 3-D image or a cyclic 4-D one."""
    if image_dimension(path) == 4:
        grid, values = read_array(path, "mr", 4)
        facts = {**_grid_facts(grid), **_value_facts(values)}
        try:
            return {**facts, "phases": len(values), **_timing_facts(series_timing(path, len(values)))}
        except UnreadableFileError as exc:  # more than one cycle, as 4-D ultrasound may have
            log.warning("%s", exc.message)
            return {**facts, "volumes": len(values)}
    volume = read_volume(path)
    return {**_grid_facts(volume.grid), **_value_facts(volume.values)}


def segmentation_facts(path: Path) -> Facts:
    """Summarise a segmentation of 3D Slicer: its segments by label, and why they cannot be used together."""
    names = {str(value): name for value, name in read_label_names(path)}
    try:
        (labels,) = read_labels(path)
    except InvalidInputError as exc:
        return {"segments": names, "problem": exc.message}
    return {"segments": names, **_grid_facts(labels.grid), **_value_facts(labels.values)}


def cine_facts(path: Path) -> Facts:
    """Facts about a folder of DICOM images: those of a cyclic image, its patient and its series."""
    cine = read_dicom_cine(path)
    return {
        "patient_id": cine.patient_id,
        "series": list(cine.series),
        **_grid_facts(cine.grid),
        **_value_facts(cine.values),
        "phases": len(cine.timing),
        **_timing_facts(cine.timing),
    }


def examination_facts(path: Path) -> Facts:
    """Facts about a folder of all series of an examination: stack, views, and what is left out."""
    examination = read_dicom_examination(path)
    sax = examination.sax
    middle = sax.grid.to_mm((np.array(sax.grid.shape) - 1.0) / 2.0)
    ends = sax.grid.to_mm(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, sax.grid.shape[2] - 1.0]]))
    views = {}
    for number, (name, view) in enumerate(zip(examination.names, examination.views, strict=True)):
        normal = view.grid.direction[:, 2]
        turn = float(np.degrees(np.arccos(min(abs(float(normal @ sax.grid.direction[:, 2])), 1.0))))
        views[f"{number + 1} {name}"] = {
            "phases": len(view.timing),
            "rr_s": view.timing.rr_s,
            "size": list(view.grid.shape[:2]),
            "spacing_mm": view.grid.spacing_mm[:2].tolist(),
            "angle_to_slices_deg": turn,
            "off_the_stack_s_middle_mm": float((middle - view.grid.origin_mm) @ normal),
        }
    return {
        "patient_id": examination.patient_id,
        "short_axis": {
            "slices": sax.grid.shape[2],
            "pitch_mm": float(sax.grid.spacing_mm[2]),
            "phases": len(sax.timing),
            "length_mm": float(np.linalg.norm(ends[1] - ends[0])),
        },
        **_grid_facts(sax.grid),
        **_timing_facts(sax.timing),
        "long_axis": views,
        "left_out": {
            f"{number + 1} {one.series or 'without a name'}": {"images": one.images, "reason": one.reason}
            for number, one in enumerate(examination.left_out)
        },
    }


def _grid_facts(grid: Grid) -> Facts:
    corners = grid.to_mm(np.array([(0, 0, 0), np.array(grid.shape) - 1], dtype=np.float64))
    return {
        "size": list(grid.shape),
        "spacing_mm": grid.spacing_mm.tolist(),
        "origin_lps_mm": grid.origin_mm.tolist(),
        "far_corner_lps_mm": corners[1].tolist(),
        "axes_lps": grid.direction.T.tolist(),
    }


def _value_facts(values: AnyArray) -> Facts:
    facts: Facts = {"type": str(values.dtype), "minimum": float(values.min()), "maximum": float(values.max())}
    if np.issubdtype(values.dtype, np.integer) and values.min() >= 0 and values.max() < 1 << 16:
        present = np.zeros(int(values.max()) + 1, dtype=np.bool_)
        present[values] = True
        facts["labels"] = np.flatnonzero(present).tolist() if present.sum() <= MOST_LABELS else None
    return facts


def _timing_facts(timing: CycleTiming) -> Facts:
    return {
        "rr_s": timing.rr_s,
        "rr_assumed": timing.rr_assumed,
        "fractions": timing.fractions.tolist(),
        "timing_assumed": timing.timing_assumed,
    }


def mesh_facts(path: Path) -> Facts:
    """Summarise counts, extent, enclosed volume, and whether a mesh is closed."""
    return _mesh_facts(read_mesh(path))


def _mesh_facts(mesh: Mesh) -> Facts:
    problem = surface_problem(mesh.vertices_mm)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    closed = bool((uses == 2).all())
    directed = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    one_way = len(np.unique(directed, axis=0)) == len(directed)
    volume_ml = mesh.volume_mm3() / 1000.0 if closed and one_way else None
    turned = None if volume_ml is not None and volume_ml > 0 else "inwards" if one_way else "different ways"
    return {
        "vertices": len(mesh.vertices_mm),
        "triangles": len(mesh.triangles),
        "lower_lps_mm": mesh.vertices_mm.min(axis=0).tolist(),
        "upper_lps_mm": mesh.vertices_mm.max(axis=0).tolist(),
        "closed": closed,
        "open_edges": int(np.count_nonzero(uses == 1)),
        "volume_ml": None if volume_ml is None else abs(volume_ml),
        "orientation": f"its triangles face {turned}; a model turns them" if closed and turned else None,
        "problem": problem and f"the surface {problem}",
    }


def surface_facts(path: Path) -> Facts:
    """The surfaces of a folder, and the first of them (EPICARDIAL if there is one) in numbers."""
    names = surface_names(path)
    series = read_surface_series(path, "EPICARDIAL" if "EPICARDIAL" in names else names[0])
    return {
        "surfaces": names,
        "surface": series.name,
        "patient_id": series.patient_id,
        "phases": len(series.timing),
        **_timing_facts(series.timing),
        **_mesh_facts(series.phase(0)),
    }


def model_facts(path: Path) -> Facts:
    """Summarise the header of a model file."""
    model = read_model(path)
    return {
        "patient_id": model.patient_id,
        "surface": model.surface_name,
        "frame": model.frame,
        "phases": model.phases,
        **_timing_facts(model.timing),
        "es_fraction": model.es_fraction,
        "ed_phase": model.ed_phase,
        "knot_spacing_mm": model.knot_spacing_mm,
        "lower_mm": model.origin_mm.tolist(),
        "upper_mm": model.upper_mm.tolist(),
        "chambers": [chamber.name for chamber in model.chambers],
        "tissue": _tissue_facts(model),
        "megabytes": model.megabytes,
        "unseen_share": model.unseen_share,
        "capped_share": float(np.concatenate(model.reference_caps).mean()),
        "sources": list(model.sources),
        "sha256": model_digest(model),
    }


def _tissue_facts(model: DvfModel) -> list[str] | str:
    """List the names of a model's tissue labels, or say that it keeps none."""
    if model.tissue is None:
        return "none: no labels, no motion between distant slices, or a file of an earlier version"
    values = np.unique(model.tissue.labels.values).tolist()
    return [model.tissue.name(value) for value in values if value != 0]


def transform_facts(path: Path) -> Facts:
    """Summarise frames, angle and shift of a transform; one that is not rigid has its matrix alone."""
    recorded = sidecar_frames(path)
    with reading(path, "an ITK transform"):
        matrix = linear_matrix(path)
    facts: Facts = {
        "name": "_from_".join(recorded) if recorded else None,
        "frames": None if recorded else "not known: from the fixed to the moving image, LPS",
        "matrix": matrix.tolist(),
    }
    try:
        rigid = rigid_from_matrix(matrix, *(recorded or ("moving", "fixed")))
    except InvalidInputError as exc:
        return {**facts, "problem": f"not rigid: {exc.message}"}
    return {
        **facts,
        "angle_deg": float(np.degrees(rigid.angle_rad)),
        "translation_mm": rigid.translation_mm.tolist(),
    }


def landmark_facts(path: Path) -> Facts:
    """Summarise names and positions of landmarks."""
    return {"points_lps_mm": _points(read_landmarks(path, "file"))}


def tag_facts(path: Path) -> Facts:
    """Summarise names and both positions of paired landmarks."""
    first, second = read_tag_pair(path, "first", "second")
    return {"first_lps_mm": _points(first), "second_lps_mm": _points(second)}


def _points(landmarks: Landmarks) -> dict[str, list[float]]:
    return dict(zip(landmarks.names, landmarks.points.xyz_mm.tolist(), strict=True))
