"""Read a scenario folder, written by `write_scenario` or put together from recordings."""

from pathlib import Path

from pydantic import ValidationError

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.scenario import Scenario
from dvf_ig.intake.named_files import named_files
from dvf_ig.intake.read import read_recordings
from dvf_ig.intake.scenario.as_session import session_of_scenario
from dvf_ig.intake.scenario.layout import CONFIG, ScenarioConfig, read_config
from dvf_ig.intake.schema import SessionConfig
from dvf_ig.io.file_within import path_within
from dvf_ig.io.provenance import record_folder


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
    session = read_scenario_session(folder, truth=truth)
    return read_recordings(session, folder, f"its {CONFIG}").scenario


def read_scenario_session(folder: Path, *, truth: bool = True) -> SessionConfig:
    """The configuration of a scenario folder; the files that it names are not opened.

    Raises:
        UnreadableFileError: no scenario folder, or its description is wrong or names files elsewhere.
    """
    config = read_config(folder)
    _require_kind(config, folder)
    try:
        session = session_of_scenario(config, folder, truth=truth)
    except ValidationError as exc:
        problem = exc.errors()[0]
        key = ".".join(map(str, problem["loc"])) or "its files"
        raise UnreadableFileError(f"{folder / CONFIG}: {key}: {problem['msg']}") from exc
    for _, name in named_files(session):
        path_within(folder, name, folder / CONFIG)
    return session


def _require_kind(config: ScenarioConfig, folder: Path) -> None:
    preop = config.preop
    if (preop.labels is None) is ("labels" in preop.kind) or bool(preop.surfaces) is not (
        "surfaces" in preop.kind
    ):
        raise UnreadableFileError(f"{folder}/{CONFIG}: preop kind is '{preop.kind}', its files differ")
