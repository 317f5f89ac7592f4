"""Read a scenario folder, written by `write_scenario` or put together from recordings."""

from pathlib import Path
from typing import Any

from dvf_ig.core.cycle import CycleTiming
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.mesh import SurfaceSeries
from dvf_ig.core.scenario import Preop, Scenario
from dvf_ig.core.sequence import Fan
from dvf_ig.core.signal import Signal
from dvf_ig.core.stream import PoseStream
from dvf_ig.core.volume import VolumeSeries
from dvf_ig.io.ecg.recording import read_ecg
from dvf_ig.io.image.timing import timing_from_document
from dvf_ig.io.image.volume import read_volume_series
from dvf_ig.io.json_file import read_json
from dvf_ig.io.landmarks import read_landmarks
from dvf_ig.io.mesh.series import read_surface_series
from dvf_ig.io.plus.latency import read_latency_recording
from dvf_ig.io.plus.nwire import read_nwire_recording
from dvf_ig.io.plus.sequence_read import read_sequence
from dvf_ig.io.provenance import record_folder
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import read_transform

from .layout import TRUTH, FilesConfig, ScenarioConfig, read_config
from .truth import FILES as TRUTH_FILES
from .truth import read_truth


def read_scenario(folder: Path | str, *, truth: bool = True) -> Scenario:
    """Read every recording of a scenario.

    Args:
        folder: holds `scenario.yaml`.
        truth: read `truth/` where it exists; False leaves it unopened.
    Raises:
        UnreadableFileError: no scenario folder, files missing (all are named), or a file that cannot be read.
    """
    folder = Path(folder)
    record_folder(folder)
    config = read_config(folder)
    _require_files(folder, config, truth)
    files = config.files
    start = folder / files.start if files.start else None
    return Scenario(
        name=config.name,
        preset=config.preset,
        preop=_preop(folder, config),
        ecg=_ecg(folder, files),
        ultrasound=read_sequence(folder / files.ultrasound),
        fan=None if config.fan is None else Fan(**config.fan.model_dump()),
        tool=_stream(folder / files.tool, "tracker", "tool"),
        pivot=_stream(folder / files.pivot, "tracker", "tool"),
        nwire=read_nwire_recording(
            folder / files.nwire,
            folder / files.nwire_device_set,
            folder / files.nwire_points,
            "CalibrationData",
        ),
        latency=read_latency_recording(
            folder / files.latency_tracker, folder / files.latency_video, folder / files.latency_lines
        ),
        start=read_transform(start, "mr", "tracker") if start is not None else None,
        landmarks_mr=read_landmarks(folder / files.landmarks_mr, "mr") if files.landmarks_mr else None,
        landmarks_tracker=read_landmarks(folder / files.landmarks_tracker, "tracker")
        if files.landmarks_tracker
        else None,
        seed=config.seed,
        truth=read_truth(folder / TRUTH) if truth and (folder / TRUTH).is_dir() else None,
    )


def _require_files(folder: Path, config: ScenarioConfig, truth: bool) -> None:
    """One sentence that names everything that is missing."""
    named = [name for role, name in config.files.model_dump().items() if name and role != "ecg"]
    if ":" not in config.files.ecg:
        named.append(config.files.ecg)
    named += [name for name in (config.preop.mr, config.preop.labels) if name]
    if truth and (folder / TRUTH).is_dir():
        named += [f"{TRUTH}/{name}" for name in TRUTH_FILES]
    missing = [name for name in named if not (folder / name).is_file()]
    if missing:
        raise UnreadableFileError(
            f"{folder} lacks {', '.join(missing)}, which its scenario.yaml names; copy the whole folder"
        )


def _ecg(folder: Path, files: FilesConfig) -> Signal:
    kind, colon, name = files.ecg.partition(":")
    return read_ecg(f"{kind}:{folder / name}" if colon else f"csv:{folder / files.ecg}")


def _stream(path: Path, target: str, source: str) -> PoseStream:
    """The only stream of a recording, or target_from_source where there are several."""
    with reading(path, "tracked poses"):
        sequence = read_sequence(path)
        if len(sequence.poses) == 1:
            return next(iter(sequence.poses.values()))
        return sequence.stream(target, source)


def _preop(folder: Path, config: ScenarioConfig) -> Preop:
    preop = config.preop
    if (preop.labels is None) is ("labels" in preop.kind) or bool(preop.surfaces) is not (
        "surfaces" in preop.kind
    ):
        raise UnreadableFileError(f"{folder}/scenario.yaml: preop kind is '{preop.kind}', its files differ")
    path = folder / preop.timing
    document: Any = read_json(path, "a timing file") if path.is_file() else {}
    return Preop(
        patient_id=config.patient_id,
        mr=_series(folder, preop.mr, path, document, "mr"),
        labels=_series(folder, preop.labels, path, document, "labels"),
        label_names=tuple(preop.label_names.items()),
        organ_labels=preop.organ_labels,
        surfaces=tuple(
            _surface(folder / preop.surfaces_folder, name, config.patient_id, path, document)
            for name in preop.surfaces
        ),
        surface=preop.surface,
    )


def _timing(path: Path, document: Any, name: str) -> CycleTiming | None:
    """The timing of one series: its own where the file lists it, else the common one; None without a file."""
    if not isinstance(document, dict) or not document or "fractions" not in document:
        return None
    with reading(path, "a timing file"):
        return timing_from_document(path, document.get("series", {}).get(name, document))


def _series(folder: Path, name: str | None, path: Path, document: Any, role: str) -> VolumeSeries | None:
    if name is None:
        return None
    timing = _timing(path, document, role)
    if timing is None and path.is_file():
        return read_volume_series(folder / name, path)
    return read_volume_series(folder / name, timing)


def _surface(folder: Path, name: str, patient_id: str, path: Path, document: Any) -> SurfaceSeries:
    timing = _timing(path, document, name) or (path if path.is_file() else None)
    series = read_surface_series(folder, name, timing)
    return SurfaceSeries(
        series.name,
        series.frame,
        series.vertices_mm,
        series.triangles,
        series.timing,
        patient_id,
        series.caps,
    )
