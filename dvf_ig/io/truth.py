"""Read and write the ground truth of a synthetic scenario: everything in its folder `truth/`."""

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, ImageMap, Landmarks, Points, Rigid, SurfaceSeries
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.recordings.scenario import BreathingTruth, ScenarioTruth, ToolTruth
from dvf_ig.io import limits
from dvf_ig.io.image.timing import timing_document, timing_from_document
from dvf_ig.io.json_file import read_json, write_json
from dvf_ig.io.limits import MODEL_BYTES
from dvf_ig.io.npz import read_npz
from dvf_ig.io.reading import read_bytes, read_text, reading
from dvf_ig.io.transform import rigid_from_matrix
from dvf_ig.io.writing.atomic import write_bytes, write_text
from dvf_ig.io.writing.place import make_folder

SCHEMA = "dvf_ig.truth/1"
FILES = ("truth.json", "r_peaks.csv", "tool.npz", "surface.npz")
BREATHING = "breathing.npz"
_BREATHING = ("t_s", "mr_from_rest", "targets_mm")
_TOOL = ("t_s", "tip_mr_mm", "phi", "model_phase", "distance_mm", "normal")


def write_truth(truth: ScenarioTruth, folder: Path) -> None:
    """Write the files of the truth, one more with breathing; every number reads back exactly.

    Raises:
        OutputError: not writable.
    """
    make_folder(folder)
    calibrated = truth.calibrated_probe_from_image
    write_json(
        folder / "truth.json",
        {
            "schema": SCHEMA,
            "units": UNITS,
            "mr_from_tracker": [
                {"from_s": start_s, "matrix": pose.matrix} for start_s, pose in truth.mr_from_tracker
            ],
            **_image_document(truth.probe_from_image),
            "later_probe_from_image": [
                {"from_s": start_s, **_image_document(image)}
                for start_s, image in truth.later_probe_from_image
            ],
            "calibrated_probe_from_image": None if calibrated is None else _image_document(calibrated),
            "tip_mm": truth.tip.xyz_mm,
            "tip_frame": truth.tip.frame,
            "lag_s": truth.lag_s,
            "video_drift_ppm": truth.video_drift_ppm,
            "respiration_mm": truth.respiration_mm,
            "mismatch_mm": truth.mismatch_mm,
            "targets": dict(zip(truth.targets.names, truth.targets.points.xyz_mm, strict=True)),
            "surface": {
                "name": truth.surface.name,
                "frame": truth.surface.frame,
                "patient_id": truth.surface.patient_id,
                "timing": timing_document(truth.surface.timing),
            },
        },
    )
    write_text(folder / "r_peaks.csv", "\n".join(["t_s", *map(repr, truth.r_peaks_s.tolist())]) + "\n")
    _write_arrays(folder / "tool.npz", {name: getattr(truth.tool, name) for name in _TOOL})
    if truth.breathing is not None:
        _write_arrays(folder / BREATHING, {name: getattr(truth.breathing, name) for name in _BREATHING})
    surface = truth.surface
    _write_arrays(
        folder / "surface.npz",
        {"vertices_mm": surface.vertices_mm, "triangles": surface.triangles, "caps": surface.caps},
    )


UNITS = "mm, s, rad, LPS"
_MOST = {
    "t_s": limits.TIME_S,
    "lag_s": limits.TIME_S,
    "tip_mr_mm": limits.LENGTH_MM,
    "distance_mm": limits.LENGTH_MM,
    "mismatch_mm": limits.LENGTH_MM,
    "respiration_mm": limits.LENGTH_MM,
    "phi": 2.0,
    "model_phase": 2.0,
    "normal": 10.0,
    "video_drift_ppm": 1e6,
}
"""Largest magnitude of each quantity; phases and unit vectors have room for rounding."""


def read_truth(folder: Path) -> ScenarioTruth:
    """Read the truth of a scenario.

    Raises:
        UnreadableFileError: a file is missing or damaged; the message names it.
    """
    path = folder / "truth.json"
    with reading(path, "the truth of a scenario"):
        document = read_json(path, "the truth of a scenario")
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise UnreadableFileError(f"{path} is not the truth of a scenario; needed schema '{SCHEMA}'")
        if document.get("units", UNITS) != UNITS:
            raise UnreadableFileError(f"{path} is in {str(document['units'])[:40]!r}; needed '{UNITS}'")
        try:
            return _truth(folder, document)
        except KeyError as exc:
            raise UnreadableFileError(f"{path} lacks {exc}; write the scenario again") from exc
        except (TypeError, ValueError, OverflowError, AttributeError) as exc:
            if isinstance(exc, InvalidInputError):
                raise
            raise UnreadableFileError(f"{path} holds a value of the wrong kind ({exc})") from exc


def _truth(folder: Path, document: dict[str, Any]) -> ScenarioTruth:
    tool = _read_arrays(folder / "tool.npz", _TOOL)
    _require_plausible(folder / "tool.npz", tool)
    _require_plausible(folder / "truth.json", document)
    for name, values in (("tip_mm", document["tip_mm"]), ("targets", list(document["targets"].values()))):
        limits.require_lengths(values, name)
    calibrated = document.get("calibrated_probe_from_image")
    return ScenarioTruth(
        mr_from_tracker=tuple(_timed_pose(entry) for entry in document["mr_from_tracker"]),
        probe_from_image=_image(document),
        tip=Points(document["tip_frame"], np.array(document["tip_mm"]).reshape(-1, 3)),
        lag_s=float(document["lag_s"]),
        r_peaks_s=_read_peaks(folder / "r_peaks.csv"),
        targets=Landmarks(
            tuple(document["targets"]),
            Points("mr", np.array(list(document["targets"].values())).reshape(-1, 3)),
        ),
        surface=_surface(folder, document["surface"]),
        tool=ToolTruth(*(tool[name] for name in _TOOL)),
        mismatch_mm=float(document["mismatch_mm"]),
        later_probe_from_image=tuple(
            (_start_s(entry), _image(entry)) for entry in document.get("later_probe_from_image", ())
        ),
        calibrated_probe_from_image=None if calibrated is None else _image(calibrated),
        video_drift_ppm=float(document.get("video_drift_ppm", 0.0)),
        respiration_mm=float(document.get("respiration_mm", 0.0)),
        breathing=_breathing(folder) if float(document.get("respiration_mm", 0.0)) > 0 else None,
    )


def _breathing(folder: Path) -> BreathingTruth:
    arrays = _read_arrays(folder / BREATHING, _BREATHING)
    _require_plausible(folder / BREATHING, arrays)
    limits.require_lengths(arrays["targets_mm"], "targets_mm")
    return BreathingTruth(*(arrays[name] for name in _BREATHING))


def _require_plausible(path: Path, values: Mapping[str, Any]) -> None:
    for name in _MOST.keys() & values.keys():
        largest = float(np.abs(np.asarray(values[name], dtype=np.float64)).max(initial=0.0))
        if not largest <= _MOST[name]:
            raise UnreadableFileError(f"{path}: {name} reaches {largest:g}; needed at most {_MOST[name]:g}")


def _image_document(image: ImageMap) -> dict[str, Any]:
    return {
        "probe_from_image": image.matrix,
        "probe_from_image_rigid": image.rigid.matrix,
        "probe_from_image_scale_mm_per_px": image.scale_mm_per_px,
        "probe_from_image_shear_deg": image.shear_deg,
    }


def _image(document: dict[str, Any]) -> ImageMap:
    if not np.max(document["probe_from_image_scale_mm_per_px"]) <= limits.VOXEL_MM[1]:
        raise InvalidInputError(f"a pixel of its images is wider than {limits.VOXEL_MM[1]:g} mm")
    return ImageMap(
        rigid_from_matrix(document["probe_from_image_rigid"], "probe", "image"),
        document["probe_from_image_scale_mm_per_px"],
        document["probe_from_image_shear_deg"],
    )


def _timed_pose(entry: dict[str, Any]) -> tuple[float, Rigid]:
    """Parse a pose and its start; JSON's null means "from the beginning"."""
    start_s = -math.inf if entry["from_s"] is None else _start_s(entry)
    return start_s, rigid_from_matrix(entry["matrix"], "mr", "tracker")


def _start_s(entry: dict[str, Any]) -> float:
    start_s = float(entry["from_s"])
    limits.require_times(start_s, "from_s")
    return start_s


def _surface(folder: Path, header: dict[str, Any]) -> SurfaceSeries:
    arrays = _read_arrays(folder / "surface.npz", ("vertices_mm", "triangles", "caps"))
    return SurfaceSeries(
        header["name"],
        header["frame"],
        arrays["vertices_mm"],
        arrays["triangles"],
        timing_from_document(folder / "truth.json", header["timing"]),
        header["patient_id"],
        arrays["caps"],
    )


def _read_peaks(path: Path) -> FloatArray:
    lines = read_text(path, "a list of R peaks").split()
    try:
        return np.array(lines[1:], dtype=np.float64)
    except ValueError as exc:
        raise UnreadableFileError(f"{path} is not a list of times: {exc}") from exc


def _write_arrays(path: Path, arrays: dict[str, AnyArray]) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())


def _read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, AnyArray]:
    arrays = read_npz(path, read_bytes(path, "the truth of a scenario"), MODEL_BYTES)
    lacking = [name for name in names if name not in arrays]
    if lacking:
        raise UnreadableFileError(f"{path} is damaged or lacks an array ({lacking[0]}); write it again")
    return arrays
