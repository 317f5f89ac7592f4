"""The files that a session's configuration names, and whether they are there."""

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.intake.ecg_name import split_ecg
from dvf_ig.intake.schema import SessionConfig, SessionDraft
from dvf_ig.io.truth import FILES as TRUTH_FILES


def require_files(config: SessionConfig, folder: Path, named_by: str) -> None:
    """Raise UnreadableFileError where files are missing: one sentence that names them all.

    Args:
        folder: where their names begin.
        named_by: what names them.
    """
    missing = [f"{name} ({key})" for key, name in named_files(config) if not is_there(folder / name, key)]
    if missing:
        where = "the working directory" if folder == Path() else str(folder)
        home = "; write out ~, your home" if any(name.startswith("~") for name in missing) else ""
        raise UnreadableFileError(
            f"{where} lacks {', '.join(missing)}, which {named_by} names; copy what is missing, or mend "
            f"its name{home}"
        )


def named_files(config: SessionConfig | SessionDraft) -> Iterator[tuple[str, str]]:
    """(key, name) of every file and folder that a configuration names; an ECG's without its prefix."""
    if config.preop is not None:
        yield from _of(config.preop, "preop", "model", "mr", "labels", "surfaces_folder", "timing")
    yield from _of(config.ultrasound, "ultrasound", "file")
    if config.ecg is not None:
        yield "ecg.file", split_ecg(config.ecg.file).name
    if config.tool is not None:
        yield from _of(config.tool, "tool", "file")
    for key in ("probe", "latency", "tip"):
        source = getattr(config.calibration, key)
        if isinstance(source, str):
            yield f"calibration.{key}", source
        elif isinstance(source, BaseModel):
            fields = [name for name in type(source).model_fields if name != "phantom"]
            yield from _of(source, f"calibration.{key}", *fields)
    yield from _of(config.start, "start", "transform", "landmarks_mr", "landmarks_tracker", "touched")
    if isinstance(config.fixtures, str):
        yield "fixtures", config.fixtures
    if config.truth is not None:
        yield from (("truth", f"{config.truth}/{name}") for name in TRUTH_FILES)


def _of(section: BaseModel, key: str, *fields: str) -> Iterator[tuple[str, str]]:
    for field in fields:
        name = getattr(section, field)
        if name is not None:
            yield f"{key}.{field}", name


def is_there(path: Path, key: str) -> bool:
    """A WFDB record is named without its ending; surfaces and poses may be folders."""
    return path.exists() or (key == "ecg.file" and path.with_name(f"{path.name}.hea").is_file())
