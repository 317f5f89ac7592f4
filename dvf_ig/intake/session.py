"""Read a session: a session.yaml, a scenario folder, or a session's log, and every file that it names."""

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dvf_ig.core import InvalidInputError, Scenario, TriggerTimes, UnreadableFileError
from dvf_ig.io.plus.names import ProbeNames, split_transform
from dvf_ig.io.provenance import record_folder
from dvf_ig.io.reading import reading
from dvf_ig.io.respiration import split_respiration
from dvf_ig.io.truth import read_truth
from dvf_ig.io.yaml_config import read_yaml, validated

from .fixtures import FixturesConfig, RetimingName, margin_options, read_fixtures
from .live import BreathFieldConfig, BreathMarkerConfig, EcgFieldConfig, LiveConfig, require_orientation
from .parts import PARTS, Opened, SessionFiles
from .problems import ProblemList
from .readers import read_session_ecg
from .scenario import CONFIG, read_scenario_config, session_of_scenario
from .schema import SCHEMA, SessionConfig, is_there, named_files

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet

OF_ANY_SESSION = ("preop", "ultrasound", "calibration.probe", "calibration.latency")
"""Parts without which recordings are none of a session; the ECG may be in the ultrasound."""
_QUANTITY = re.compile(r"[-+]?[\d.,]+ ?[a-zµ]* \(.*\)")
"""A number, perhaps with its unit, in place of a file name, and the key that holds it."""
Purpose = Literal["recording", "live"]
"""Whether recordings are read, or only what a live session begins with."""


def read_session(path: Path | str, purpose: Purpose = "recording", *, truth: bool = True) -> SessionFiles:
    """Read a session and every file that it names.

    Args:
        path: a session.yaml, a scenario folder, or a log (.mcap) of `dvf-ig serve` or `dvf-ig export mcap`.
        purpose: "live" opens no recordings, which are sent.
        truth: read the truth of a synthetic scenario; False leaves it unopened.
    Raises:
        UnreadableFileError: a file is absent (all absent ones are named) or cannot be read.
        InvalidInputError: files that do not fit each other.
        QualityGateError: a calibration that was refused.
    """
    path = Path(path)
    if path.suffix == ".mcap" and path.is_file():
        from .session_log.read import read_session_log

        return read_session_log(path)
    config, folder = open_session(path, truth=truth)
    if path.is_dir():
        record_folder(path)
    if purpose == "live":
        return _live_files(config, folder, path)
    _require_files(config, folder, _named_by(path))
    return _read_all(config, folder, _named_by(path))


def read_scenario(folder: Path | str, *, truth: bool = True) -> Scenario:
    """Read every recording of a scenario folder.

    Args:
        folder: holds `scenario.yaml`.
        truth: read `truth/` if there is one; False leaves it unopened.
    Raises:
        UnreadableFileError: no scenario folder, files missing (all are named), or a file that cannot be read.
    """
    folder = Path(folder)
    record_folder(folder)
    read_scenario_config(folder)
    return read_session(folder, truth=truth).scenario


def open_session(path: Path | str, *, truth: bool = True) -> tuple[SessionConfig, Path]:
    """The configuration of a session.yaml or a scenario folder, and the folder where its names begin.

    The files that it names are not opened.

    Raises:
        UnreadableFileError: absent, not YAML, unknown keys, wrong values, or no scenario folder.
    """
    path = Path(path)
    if path.is_dir():
        return session_of_scenario(path, truth=truth), path
    document = read_yaml(path, "a session's configuration")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else None
        hint = "give its folder" if got == "dvf_ig.scenario/1" else "begin one with: dvf-ig config init"
        raise UnreadableFileError(f"{path} has schema '{got}'; needed '{SCHEMA}': {hint}")
    stated = {key: value for key, value in document.items() if value is not None}  # the rest is commented out
    return validated(SessionConfig, stated, path), path.parent


def examine(
    config: SessionConfig, folder: Path, named_by: str, purpose: Purpose = "recording"
) -> tuple[SessionFiles, ProblemList]:
    """Read what can be read of a session, and collect why the rest cannot.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
        purpose: as of `read_session`.
    """
    problems, names = ProblemList(), ProbeNames()
    files = [(key, folder / name) for key, name in named_files(config)]
    for key, path in files if purpose == "recording" else ():
        if not is_there(path, key):
            with problems.about(key):
                raise UnreadableFileError(
                    f"{path} does not exist; copy it there, or correct its name", path=path
                )
    us, live = config.ultrasound, config.live
    probe = None if live is None or us is not None else split_transform(live.probe)
    tool = None if live is None or purpose == "recording" else split_transform(live.tool)
    with problems.about("ultrasound"):
        if us is not None:
            names = ProbeNames.from_plus(us.probe_name, us.reference_name)
        elif probe is not None:
            names = ProbeNames(probe[1])
    opened = Opened(config, folder, names, "tool" if tool is None else tool[1])
    for part in PARTS:
        if (part.live or purpose == "recording") and not problems.within(part.key):
            with problems.about(part.key):
                opened.read.update(part.read(opened))
    if purpose == "live" and us is not None and us.fan is not None:
        with problems.about("ultrasound.fan"):
            opened.read["fan"] = us.fan.fan()
    with problems.about("fixtures"):
        opened.read["fixtures"], opened.read["retiming"] = session_fixtures(config, folder, named_by)
    if config.truth is not None and purpose == "recording" and not problems.within("truth"):
        with problems.about("truth"):
            opened.read["truth"] = read_truth(folder / config.truth)
    read = SessionFiles(
        **opened.read,
        live=live,
        name=config.name,
        preset=config.preset,
        seed=config.seed,
        folder=folder,
        named=dict(files),
    )
    return read, problems


def _read_all(
    config: SessionConfig, folder: Path, named_by: str, purpose: Purpose = "recording"
) -> SessionFiles:
    """Everything; raises what is not named, or the first problem."""
    files, problems = examine(config, folder, named_by, purpose)
    lacking = [
        f"{part.key}: {part.missing}"
        for part in PARTS
        if part.key in OF_ANY_SESSION and not part.is_there(files) and not problems.within(part.key)
    ]
    if lacking and purpose == "recording":
        raise UnreadableFileError(f"{named_by} lacks {'; '.join(lacking)}")
    for problem in problems.items:
        raise problem.error
    return files


def _live_files(config: SessionConfig, folder: Path, path: Path) -> SessionFiles:
    """Read what a live session begins with; a scenario folder is streamed as it was recorded."""
    if config.live is None and path.is_dir() and config.ultrasound is not None:
        sweep = None if config.ultrasound.file is None else folder / config.ultrasound.file
        ecg = read_session_ecg(config.ecg, folder, sweep)
        if isinstance(ecg, TriggerTimes):
            raise InvalidInputError(f"{folder} has a trigger in place of an ECG; a live session takes an ECG")
        live = LiveConfig(ecg=EcgFieldConfig(rate_hz=ecg.rate_hz), respiration=streamed_breath(config))
        config = config.model_copy(update={"live": live})
    if config.live is None:
        raise UnreadableFileError(
            f"{path} has no section 'live', which says who sends what: for example\n"
            "live: {probe: ProbeToTracker, tool: ToolToTracker, image: Image_Tracker, "
            "ecg: {field: EcgData, rate_hz: 500}}",
            key="live",
        )
    if config.respiration is not None and config.live.respiration is None:
        raise InvalidInputError(
            f"{path} names a recording of breathing, but not what sends it in a live session: forces would "
            "be given as if the heart did not move with the breath; state live.respiration (a marker, a "
            "field or an LSL stream), or remove 'respiration' for apnoea or high-frequency ventilation",
            key="live.respiration",
        )
    files = _read_all(config, folder, str(path), "live")
    for part in PARTS:
        if part.live and part.needed_for and not part.is_there(files):
            raise part.missing_error
    require_orientation(config.live, config.calibration.probe, folder)
    return files


def streamed_breath(config: SessionConfig) -> BreathFieldConfig | BreathMarkerConfig | None:
    """State how a scenario's breathing is streamed; None without any."""
    if config.respiration is None:
        return None
    if split_respiration(config.respiration.file).prefix == "marker:":
        return BreathMarkerConfig(marker="ChestToTracker")
    return BreathFieldConfig(field="RespirationData")


def _named_by(path: Path) -> str:
    return f"its {CONFIG}" if path.is_dir() else str(path)


def _require_files(config: SessionConfig, folder: Path, named_by: str) -> None:
    """Raise UnreadableFileError if files are missing: one sentence that names them all."""
    missing = [
        f"{name.encode('unicode_escape').decode() if not name.isprintable() else name} ({key})"
        for key, name in named_files(config)
        if not is_there(folder / name, key)
    ]
    if missing:
        hint = "; write out ~, your home" if any(name.startswith("~") for name in missing) else ""
        hint += "; write / for \\" if any("\\" in name for name in missing) else ""
        if any(_QUANTITY.fullmatch(name) for name in missing):
            hint += "; a number is written without quotes and unit"
        where = "the working directory" if folder == Path() else str(folder)
        raise UnreadableFileError(
            f"{where} lacks {', '.join(missing)}, which {named_by} names; copy what is missing, or correct "
            f"its name{hint}"
        )


def session_fixtures(
    config: SessionConfig, folder: Path, named_by: str
) -> tuple["FixtureSet | None", RetimingName | None]:
    """Fixtures and retiming that a configuration states or names; None if it leaves them open.

    Raises:
        UnreadableFileError: values out of range, or a joint cap or a device together with the name of a file,
            which states them itself.
    """
    margin, tool = config.margin, config.tool
    shape = tool if tool is not None and tool.stated else None
    if all(stated is None for stated in (config.fixtures, config.cap_n, config.device, margin, shape)):
        return None, config.retiming
    if isinstance(config.fixtures, str):
        beside = [key for key in ("cap_n", "device") if getattr(config, key) is not None]
        if beside:
            raise UnreadableFileError(
                f"{named_by}: {' and '.join(beside)} belongs in {config.fixtures}, which describes the "
                "fixtures; move it there"
            )
        fixtures, retiming = read_fixtures(folder / config.fixtures)
        if margin is not None:
            fixtures = replace(fixtures, margin=margin_options(margin))
        if shape is not None:
            with reading(Path(named_by), "a session's configuration"):
                fixtures = replace(fixtures, tool=shape.shape())
        return fixtures, config.retiming or retiming
    with reading(Path(named_by), "a session's configuration"):
        of_session = FixturesConfig(
            fixtures=FixturesConfig().fixtures if config.fixtures is None else config.fixtures,
            cap_n=config.cap_n,
            device=config.device,
            margin="off" if margin is None else margin,
            tool=shape,
        )
        return of_session.fixture_set(folder), config.retiming
