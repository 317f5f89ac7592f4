"""Describe a file: its kind and the few facts that a user wants to see before using it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import ImageMap, LatencyRecording, NWireRecording, PoseStream, Scenario, Signal, TriggerTimes
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.intake.scenario import CONFIG
from dvf_ig.intake.session import read_scenario
from dvf_ig.io import ProbeNames, is_dicom_folder, read_annotations, read_label_names, read_points, read_poses
from dvf_ig.io.dicom.examination import is_examination
from dvf_ig.io.ecg.recording import foreign_recording, names_ecg, read_ecg
from dvf_ig.io.itk_transform import is_itk_text
from dvf_ig.io.landmarks import is_markups
from dvf_ig.io.mesh.file import DECODERS
from dvf_ig.io.mesh.series import surface_names
from dvf_ig.io.number_table import read_number_table
from dvf_ig.io.plus.feature_points import read_feature_points, tracked_probe
from dvf_ig.io.plus.sequence_read import PIXEL_FRAMES, read_sequence
from dvf_ig.io.plus.xml import CoordinateDefinition, parse_xml, read_transforms
from dvf_ig.io.reading import read_bytes
from dvf_ig.io.respiration import names_breathing, read_respiration

from . import anatomy
from .own import RUN, SESSION, json_facts, log_facts, run_facts, session_facts, yaml_facts
from .sequence import clock_facts, sequence_facts, sequence_file_facts, signal_facts, stream_facts

Facts = dict[str, Any]
TABLES = (".txt", ".csv", ".tsv")
UNIT = 0.01
MOST_NAMES = 10
"""Most names of files that a message lists."""
Reader = Callable[[Path], Facts]


@dataclass(frozen=True, slots=True)
class Description:
    """Kind of a file in a few words and its facts by name, ready for JSON; units are in the names."""

    kind: str
    facts: Facts


def describe(
    spec: str, rate_hz: float | None = None, names: ProbeNames | None = None, lead: str | None = None
) -> Description:
    """Identify a file by its name and content, read it, and summarise it.

    Args:
        spec: a path, or an ECG as `wfdb:PATH`, `edf:PATH`, `csv:PATH`, `plus:PATH`.
        rate_hz: sampling rate of an ECG that states none.
        names: of the probe and its reference in a tracked sequence, whose joined pose is described as well.
        lead: leads of an ECG to describe instead of all that are named as one.
    Raises:
        UnreadableFileError: absent, of no known kind, or not readable as the kind that it claims to be.
        InvalidInputError: a rate for anything but an ECG table, or names that are not in a tracked sequence.
    """
    path = Path(spec)
    tabled = path.is_file() and spec.lower().endswith(TABLES) and _table_kind(path, lead) is not None
    if names_ecg(spec) and not tabled:
        if names is not None:
            raise InvalidInputError(
                f"names of probe and reference belong to a tracked sequence; '{spec}' is an ECG"
            )
        try:
            facts_of_ecg = signal_facts(read_ecg(spec, rate_hz, lead))
        except UnreadableFileError:
            breathing = _breathing(path, rate_hz) if lead is None and path.is_file() else None
            if breathing is None:
                raise
            return Description("breathing", breathing)
        if spec.endswith(".atr"):
            facts_of_ecg["annotated_beats"] = len(read_annotations(spec).t_s)
        return Description("ECG", facts_of_ecg)
    if rate_hz is not None or lead is not None:
        what = "lead" if rate_hz is None else "sampling rate"
        raise InvalidInputError(f"a {what} belongs to an ECG; '{spec}' is not one")
    if not path.exists():
        raise UnreadableFileError(f"{path} does not exist; check the name")
    if other := foreign_recording(path):
        raise UnreadableFileError(f"{path} is {other}")
    kind, facts = _folder_kind(path) if path.is_dir() else _file_kind(path)
    if names is None:
        return Description(kind, facts(path))
    if facts is not sequence_file_facts:
        raise InvalidInputError(
            f"names of probe and reference belong to a tracked sequence; {path} is: {kind}"
        )
    stream = tracked_probe(read_sequence(path), names)
    return Description(kind, {**facts(path), "probe": {stream.name: stream_facts(stream)}})


def _folder_kind(path: Path) -> tuple[str, Reader]:
    if (path / CONFIG).is_file():
        return "scenario folder", _scenario_facts
    if (path / RUN).is_file():
        return "folder of a replay", run_facts
    if (path / SESSION).is_file():
        return "folder of a session", lambda folder: session_facts(folder / SESSION)
    if is_dicom_folder(path):
        if is_examination(path):
            return "examination of DICOM images", anatomy.examination_facts
        return "cine of DICOM images", anatomy.cine_facts
    if surface_names(path):
        return "surfaces through the cycle", anatomy.surface_facts
    endings = {one.suffix.lower() for one in path.iterdir() if one.is_file() and one.name[0] != "."}
    if endings and endings <= {"", ".dat", *TABLES}:
        return "tool poses, one 4x4 text file each", _pose_facts
    listed = ", ".join(sorted(one.name for one in path.iterdir())[:MOST_NAMES]) or "nothing"
    raise UnreadableFileError(
        f"{path} is a folder of no kind that can be read, with {listed}; give a scenario, a run, surfaces, "
        "DICOM images or poses, or one of its files"
    )


def _file_kind(path: Path) -> tuple[str, Reader]:
    name = path.name.lower()
    by_ending: list[tuple[tuple[str, ...], str, Reader]] = [
        (tuple(DECODERS), "triangle mesh", anatomy.mesh_facts),
        ((".npz",), "fixture model", anatomy.model_facts),
        ((".tfm", ".h5", ".mat"), "transform", anatomy.transform_facts),
        ((".mrk.json", ".fcsv"), "landmarks", anatomy.landmark_facts),
        ((".mcap",), "log of a session", log_facts),
        ((".tag",), "landmarks in two volumes", anatomy.tag_facts),
        ((".nii", ".nii.gz"), "image", anatomy.image_facts),
        ((".xml",), "PLUS configuration or result", _xml_facts),
    ]
    for endings, kind, facts in by_ending:
        if name.endswith(endings):
            return kind, facts
    if name.endswith((".json", ".yaml", ".yml")):
        if name.endswith(".json") and is_markups(path):
            return "landmarks", anatomy.landmark_facts
        kind, own = (json_facts if name.endswith(".json") else yaml_facts)(path)
        return kind, lambda _: own
    if name.endswith(TABLES):
        return _table_kind(path) or ("tool poses, one row each", _pose_facts)
    if name.endswith((".mha", ".mhd", ".nrrd", ".nhdr")):
        tracked = (
            ".igs." in name or b"Seq_Frame" in read_bytes(path, "an image or a tracked sequence")[:65536]
        )
        if tracked:
            return "tracked sequence", sequence_file_facts
        return (
            ("segmentation", anatomy.segmentation_facts)
            if read_label_names(path)
            else ("image", anatomy.image_facts)
        )
    if is_dicom_folder(path):
        return "cine of DICOM images", anatomy.cine_facts
    raise UnreadableFileError(
        f"{path} is of no kind that can be read; give a tracked sequence (.igs.mha, .igs.nrrd), an image "
        "(.nii.gz, .nrrd, .mha), mesh (.obj, .stl, .ply, .vtp), model (.npz), transform (.tfm, .h5), "
        "landmarks (.mrk.json, .fcsv, .tag), table (.csv, .txt), PLUS .xml, session (.yaml, .mcap), result "
        "(.json), ECG (wfdb:, edf:, csv:, plus:) or the folder of a scenario, replay or session"
    )


def _table_kind(path: Path, lead: str | None = None) -> tuple[str, Reader] | None:
    """Identify a text file as an ITK transform, poses, points or segmented points; None for another table."""
    if is_itk_text(path):
        return "transform", anatomy.transform_facts
    try:
        table = read_number_table(path, "a table of numbers")
    except UnreadableFileError:
        return None  # an ECG has other forms, whose reader states what is wrong
    columns, names = table.values.shape[1], set(table.names or ())
    lengths = np.linalg.norm(table.values[:, -4:], axis=1)
    unit = bool((np.abs(lengths[np.isfinite(lengths)] - 1) < UNIT).all())  # as the quaternions of poses
    if {"qx", "qy", "qz"} <= names or (not names and columns in (7, 8) and unit):
        return "tool poses, one row each", _pose_facts
    if names in ({"x", "y", "z"}, {"r", "a", "s"}, {"l", "p", "s"}):
        return "points", _point_facts
    if not names and columns == 3 and lead is None:
        raise UnreadableFileError(
            f"{path} is a table of 3 columns without names: points (then name them x,y,z), or a time "
            "and two channels (then name the lead, --lead 'column 2'); write the names in the first row"
        )
    if "frame" in names and "column1" in names:
        return "segmented points, one row an image", lambda file: {"images": len(read_feature_points(file))}
    return None


def _breathing(path: Path, rate_hz: float | None) -> Facts | None:
    """Describe a table whose channel is named as breathing is; None for another."""
    try:
        breath = read_respiration(f"csv:{path}", rate_hz)
    except UnreadableFileError:
        return None
    if not names_breathing(breath.name):
        return None
    return {"channel": breath.name, "samples": len(breath), **clock_facts(breath.t_s)}


def _point_facts(path: Path) -> Facts:
    xyz_mm = read_points(path, "file").xyz_mm
    return {
        "points": len(xyz_mm),
        "lower_lps_mm": xyz_mm.min(axis=0).tolist(),
        "upper_lps_mm": xyz_mm.max(axis=0).tolist(),
    }


def _pose_facts(path: Path) -> Facts:
    stream = read_poses(path)
    return {"transform": stream.name, **stream_facts(stream)}


def _xml_facts(path: Path) -> Facts:
    root = parse_xml(path, "a PLUS file")
    placed = read_transforms(path, root)
    return {
        "root": root.tag,
        "transforms": {
            name: {"error_mm": entry.error_mm, "date": entry.date, **_image_map_facts(entry)}
            for name, entry in placed.items()
        },
        "nwire_patterns": sum(1 for p in root.iter("Pattern") if p.attrib.get("Type") == "NWire"),
        "landmarks": sum(1 for _ in root.iter("Landmark")),
        "frames": {
            part: sum(1 for _ in element.iter("Frame"))
            for part in ("CalibrationData", "ValidationData", "LineSegmentationResults")
            for element in root.iter(part)
        },
    }


def _image_map_facts(entry: CoordinateDefinition) -> Facts:
    """Report pixel size and shear of an image map, or why it cannot be used."""
    if entry.source != "image" or entry.target in PIXEL_FRAMES:
        return {}
    try:
        placed = ImageMap.from_matrix(entry.matrix, entry.target, entry.source)
    except InvalidInputError as exc:
        return {"problem": str(exc)}
    return {"mm_per_px": placed.scale_mm_per_px.tolist(), "shear_deg": placed.shear_deg}


def _beat_source_facts(source: Signal | TriggerTimes) -> Facts:
    if isinstance(source, TriggerTimes):
        return {"pulses": len(source), "start_s": source.start_s, "delay_s": source.delay_s}
    return {
        "leads": list(source.leads),
        "rate_hz": source.rate_hz,
        "start_s": source.start_s,
        "duration_s": len(source) / source.rate_hz,
    }


def _scenario_facts(path: Path) -> Facts:
    scenario = read_scenario(path)
    preop = scenario.preop
    series = [s for s in (preop.mr, preop.labels) if s is not None]
    return {
        "name": scenario.name,
        "preset": scenario.preset,
        "seed": scenario.seed,
        "patient_id": preop.patient_id,
        "preop_images": [[*s.values.shape[1:], len(s.timing)] for s in series],
        "preop_surfaces": [s.name for s in preop.surfaces],
        "ecg": _beat_source_facts(scenario.ecg),
        "ultrasound": sequence_facts(scenario.ultrasound),
        **_calibration_facts(scenario),
        "start": scenario.start is not None,
        "landmarks": 0 if scenario.landmarks_mr is None else len(scenario.landmarks_mr.names),
        "truth": scenario.truth is not None,
    }


def _calibration_facts(scenario: Scenario) -> dict[str, Any]:
    """Facts about the tool and the recordings that calibrate it, the probe and the latency."""
    tool, tip, probe, latency = scenario.tool, scenario.tip, scenario.probe, scenario.latency
    out: dict[str, Any] = {}
    if tool is not None:
        out["tool"] = {**clock_facts(tool.t_s), **stream_facts(tool)}
    if isinstance(tip, PoseStream):
        out["pivot_poses"] = len(tip)
    if isinstance(probe, NWireRecording):
        out["nwire_frames"] = len(probe.phantom_from_probe)
    if isinstance(latency, LatencyRecording):
        out["latency_frames"] = len(latency.wall_row_px.t_s)
    return out
