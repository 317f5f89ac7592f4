"""Facts about the files and folders that this program writes: results, sessions, runs, session logs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.intake.fixtures import read_fixtures
from dvf_ig.intake.scenario import CONFIG
from dvf_ig.intake.schema import SCHEMA, is_there, named_files
from dvf_ig.intake.session import open_session, read_session
from dvf_ig.io import read_hand_eye, read_json, read_lag, read_landmark_map, read_probe, read_tip
from dvf_ig.io.image.seeds import KINDS, read_seeds
from dvf_ig.io.image.timing import timing_from_document
from dvf_ig.io.provenance import MARK
from dvf_ig.io.reading import reading
from dvf_ig.io.yaml_config import read_yaml

Facts = dict[str, Any]

RUN = "result.json"
SESSION = "session.yaml"
MOST_NUMBERS = 16
"""Longest list of numbers in a result that is shown, as of a 4x4 matrix; longer ones are evidence."""
_CALIBRATIONS: dict[str, Callable[..., Any]] = {
    "tip": read_tip,
    "latency": read_lag,
    "landmarks": read_landmark_map,
    "hand-eye": read_hand_eye,
}
_PROVENANCE = ("inputs", "versions", "written_by", "kind", "@schema")


def json_facts(path: Path) -> tuple[str, Facts]:
    """Identify a JSON file that this program wrote, and return its kind and its facts.

    Raises:
        UnreadableFileError: not JSON, not written by this program, or a damaged calibration.
    """
    document = read_json(path)
    if not isinstance(document, dict):
        raise UnreadableFileError(f"{path} is a JSON list; needed a result, markups or a calibration")
    if document and set(document) <= set(KINDS):
        seeds = read_seeds(path)
        return "seeds", {kind: len(getattr(seeds, kind)) for kind in KINDS}
    if "fractions" in document and "kind" not in document:
        with reading(path, "a timing file"):
            timing_from_document(path, document)
    kind, schema = document.get("kind"), document.get("schema", "")
    named = path.name == RUN or "fractions" in document or str(schema).startswith(f"{MARK}.")
    if not named and document.get("written_by") != MARK and "refused" not in document:
        raise UnreadableFileError(
            f"{path} is no JSON file that dvf-ig wrote (no kind, no schema); give a result, calibration, "
            ".mrk.json or timing.json"
        )
    if kind == "probe":
        read_probe(path, str(document.get("sensor_frame")), allow_refused=True)
    elif str(kind) in _CALIBRATIONS:
        _CALIBRATIONS[str(kind)](path, allow_refused=True)
    what = kind or (str(schema) if schema else "phase times" if "fractions" in document else "replay")
    return f"result of dvf-ig: {what}", _shown(document)


def _shown(document: dict[str, Any]) -> Facts:
    """Keep numbers, texts and short lists, also one level down; leave out provenance and evidence."""
    facts: Facts = {}
    for name, value in document.items():
        if name in _PROVENANCE or value in (None, [], {}):
            continue
        if isinstance(value, dict):
            inner = {k: v for k, v in value.items() if v is not None and _is_short(v)}
            facts |= {name: inner} if inner else {}
        elif _is_short(value):
            facts[name] = value
    return facts


def _is_short(value: Any) -> bool:
    if isinstance(value, list):
        rows = [row if isinstance(row, list) else [row] for row in value]
        numbers = [entry for row in rows for entry in row]
        return len(numbers) <= MOST_NUMBERS and not any(isinstance(e, dict | list) for e in numbers)
    return not isinstance(value, dict)


def yaml_facts(path: Path) -> tuple[str, Facts]:
    """Identify a YAML file as a session or as fixtures, and return its kind and its facts."""
    document = read_yaml(path, "a session or fixtures")
    schema = document.get("schema") if isinstance(document, dict) else None
    if path.name == CONFIG:
        return "scenario", session_facts(path.parent)
    if schema == SCHEMA:
        return "session", session_facts(path)
    fixtures, retiming = read_fixtures(path)
    laws = [type(one.law).__name__.lower() for one in fixtures.fixtures]
    return "fixtures", {"laws": laws, "cap_n": fixtures.cap_n, "retiming": retiming}


def session_facts(path: Path) -> Facts:
    """List the files that a session names by their keys, and those that are missing; none is opened."""
    config, folder = open_session(path)
    files = dict(named_files(config))
    missing = [key for key, name in files.items() if not is_there(folder / name, key)]
    return {"name": config.name, "patient_id": config.patient_id, "files": files, "missing": missing or None}


def run_facts(folder: Path) -> Facts:
    """Summarise the folder of a replay: its result, and its other files."""
    others = sorted(entry.name for entry in folder.iterdir() if entry.name != RUN)
    return {**json_facts(folder / RUN)[1], "files": others}


def log_facts(path: Path) -> Facts:
    """Summarise the session in a log (`.mcap`) without registering anything."""
    files = read_session(path)
    sweep, tool = files.sweep, files.tool
    return {
        "name": files.name,
        "preset": files.preset,
        "ultrasound_frames": 0 if sweep is None else len(sweep.recorded),
        "tool_poses": 0 if tool is None else len(tool),
        "model": None if files.model is None else files.model.surface_name,
        "live": files.record is not None,
    }
