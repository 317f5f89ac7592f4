"""The page that follows one frame names modules, functions, times and terms that are there."""

import ast
import re
from pathlib import Path

from dvf_ig.core.space import pose_motion
from dvf_ig.session import (
    arrived_ultrasound,
    beat_evaluation,
    clocks,
    gated_frames,
    pose_states,
    registration_plan,
    tool_tracker,
    work,
)
from dvf_ig.session import heart as session_heart

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "dvf_ig/docs/guide/one-frame.md").read_text(encoding="utf-8")
GLOSSARY = (ROOT / "dvf_ig/docs/glossary.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `(dvf_ig/[\w/]+\.py)` `([\w.]+)` \|", PAGE, re.MULTILINE)


def defined_in(path: str) -> set[str]:
    """Functions, classes, and methods as `Class.method`, of a module."""
    names: set[str] = set()
    for node in ast.parse((ROOT / path).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{part.name}" for part in node.body if isinstance(part, ast.FunctionDef)}
    return names


def test_every_module_has_the_function_that_the_page_names() -> None:
    assert len(ROWS) == PAGE.count("\n| `dvf_ig/")
    missing = {path: name for path, name in ROWS if name not in defined_in(path)}
    assert not missing


def test_no_function_stands_there_twice_and_every_step_of_the_session_does() -> None:
    paths = [path for path, _ in ROWS]
    assert len(ROWS) == len(set(ROWS))
    steps = {path.relative_to(ROOT).as_posix() for path in (ROOT / "dvf_ig/session").glob("*.py")}
    others = {"__init__", "heart", "history", "reasons", "setup"}
    assert steps - set(paths) == {f"dvf_ig/session/{name}.py" for name in others}


def test_the_modules_of_the_drawing_are_in_the_tables() -> None:
    drawing = PAGE.split("```")[1]
    named = set(re.findall(r"\b[a-z]+_[a-z_]+\b", drawing))
    assert len(named) >= 9
    assert not named - {Path(path).stem for path, _ in ROWS}


def test_every_term_is_in_the_glossary() -> None:
    terms = re.findall(r"^\| ([^|]+?) \|", GLOSSARY, re.MULTILINE)
    known = {term for row in terms for term in re.split(r"[,;] ", row)}
    said = {term if term in known else term.removesuffix("s") for term in re.findall(r"\*\*(.+?)\*\*", PAGE)}
    assert len(said) > 30
    assert not said - known


def test_the_times_are_the_code_s() -> None:
    text = " ".join(PAGE.split())
    for stated in (
        f"a beat are gathered {work.BEAT_GATHER_S:g} s after $D$",
        f"a registration {work.GATHER_S:g} s after",
        f"$A$ + {work.COMPUTE_S:g} s",
        f"$D$ + {beat_evaluation.BEAT_COMPUTE_S:g} s",
        f"for {arrived_ultrasound.KEEP_S:g} s",
        f"{gated_frames.MIN_FRAMES} to {gated_frames.MAX_FRAMES} slices",
        f"of up to {registration_plan.MEMORY_S:g} s, coarse and fine",
        f"{session_heart.FINE_PITCH_MM:g} or {session_heart.COARSE_PITCH_MM:g} mm a pixel",
        f"more than {clocks.JITTER_S:g} s back",
        f"{pose_states.MAX_AGE_S:g} s or three beats",
        f"no more than {pose_motion.UPDATE_MM_PER_S:g} mm/s",
        f"the last {1000 * tool_tracker.VELOCITY_SPAN_S:g} ms",
        f"for {1000 * tool_tracker.MAX_AGE_S:g} ms at most",
    ):
        assert stated in text, stated
    assert pose_states.MAX_MISSED_BEATS == 3
