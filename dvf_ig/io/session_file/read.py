"""Read every recording that a session's configuration names."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.model import DvfModel
from dvf_ig.core.scenario import Scenario
from dvf_ig.core.sequence import Fan, TrackedSequence
from dvf_ig.core.signal import Signal
from dvf_ig.core.stream import PoseStream
from dvf_ig.core.trigger import TriggerTimes
from dvf_ig.io.ecg.recording import read_ecg
from dvf_ig.io.ecg.trigger import read_beat_source
from dvf_ig.io.fixtures import FixturesConfig, RetimingName, read_fixtures
from dvf_ig.io.landmarks import read_landmarks
from dvf_ig.io.plus.feature_points import tracked_probe
from dvf_ig.io.plus.names import ProbeNames, frame_from_plus
from dvf_ig.io.plus.poses import read_poses
from dvf_ig.io.plus.sequence_read import read_sequence
from dvf_ig.io.points_file import read_points
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import read_transform
from dvf_ig.io.truth import read_truth
from dvf_ig.io.yaml_config import read_yaml, validated

from .calibration import read_latency_source, read_probe_source, read_tip_source
from .named_files import require_files, split_ecg
from .preop import read_preop
from .schema import SCHEMA, EcgConfig, SessionConfig, StartConfig, ToolConfig

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet


@dataclass(frozen=True, slots=True, eq=False)
class SessionRecordings:
    """What a session's configuration names, read.

    Attributes:
        scenario: every recording.
        model: of the patient, where a file holds it.
        fixtures: None where the configuration describes none.
        retiming: how the beat is mapped to the model's cycle; None where it does not say.
    """

    scenario: Scenario
    model: DvfModel | None
    fixtures: "FixtureSet | None"
    retiming: RetimingName | None


def read_session_config(path: Path | str) -> SessionConfig:
    """Parse and check a SESSION.yaml; the files that it names are not opened.

    Raises:
        UnreadableFileError: absent, not YAML, unknown keys, or missing or wrong values.
    """
    path = Path(path)
    document = read_yaml(path, "a session's configuration")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else None
        raise UnreadableFileError(f"{path} has schema '{got}'; needed '{SCHEMA}' (dvf-ig config init)")
    return validated(SessionConfig, document, path)


def read_session(path: Path | str) -> SessionRecordings:
    """Read a SESSION.yaml and every file that it names.

    Raises:
        UnreadableFileError: a file is absent (all absent ones are named) or cannot be read.
        InvalidInputError: files that do not fit each other.
        QualityGateError: a calibration that was refused.
    """
    path = Path(path)
    return read_recordings(read_session_config(path), path.parent, str(path))


def read_options(document: dict[str, Any]) -> SessionRecordings:
    """Read what the options of a command name: the content of a SESSION.yaml in the working directory.

    Raises:
        as `read_session`.
    """
    return read_recordings(validated(SessionConfig, document, Path("options")), Path(), "the command")


def read_recordings(config: SessionConfig, folder: Path, named_by: str) -> SessionRecordings:
    """Read every file of a configuration.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    Raises:
        as `read_session`.
    """
    require_files(config, folder, named_by)
    names = ProbeNames.from_plus(config.ultrasound.probe_name, config.ultrasound.reference_name)
    files = read_preop(config.preop, folder, config.patient_id)
    sweep = folder / config.ultrasound.file
    with reading(sweep, "tracked ultrasound"):
        recorded = read_sequence(sweep)
        probe = tracked_probe(recorded, names)
    tool = _tool(config.tool, folder, recorded, probe)
    calibration, start, fan = config.calibration, config.start, config.ultrasound.fan
    tip = None
    if calibration.tip is not None:
        tip = read_tip_source(calibration.tip, folder, "tool" if tool is None else tool.source)
    scenario = Scenario(
        name=config.name or files.preop.patient_id,
        preset=config.preset,
        preop=files.preop,
        ecg=_ecg(config.ecg, folder, sweep),
        ultrasound=_ultrasound(recorded, probe),
        fan=None if fan is None else Fan(**fan.model_dump()),
        probe=read_probe_source(calibration.probe, folder, names),
        latency=read_latency_source(calibration.latency, folder),
        tool=None if tool is None else replace(tool, target="tracker", source="tool"),
        tip=tip,
        **_start(start, folder),
        seed=config.seed,
        truth=None if config.truth is None else read_truth(folder / config.truth),
    )
    fixtures, retiming = _fixtures(config, folder, named_by)
    return SessionRecordings(scenario, files.model, fixtures, retiming)


def _ultrasound(recorded: TrackedSequence, probe: PoseStream) -> TrackedSequence:
    """The same with one stream, tracker_from_probe, whatever the recording calls the two."""
    named = replace(probe, target="tracker", source="probe")
    return replace(recorded, poses={named.name: named})


def _tool(
    config: ToolConfig | None, folder: Path, recorded: TrackedSequence, probe: PoseStream
) -> PoseStream | None:
    """The tool's poses against what the probe's are relative to; None where none is named or recorded."""
    if config is not None:
        source = None if config.name is None else frame_from_plus(config.name)
        return read_poses(folder / config.file, probe.target, source)
    others = {stream.source for stream in recorded.poses.values()} - {probe.source, probe.target, "reference"}
    return recorded.stream(probe.target, others.pop()) if len(others) == 1 else None


def _ecg(config: EcgConfig | None, folder: Path, sweep: Path) -> Signal | TriggerTimes:
    """From its own file, else from the field data of the ultrasound."""
    if config is None:
        return read_ecg(f"plus:{sweep}")
    spec = split_ecg(config.file)
    named = f"{spec.prefix}{folder / spec.name}{spec.field}"
    return read_beat_source(named, rate_hz=config.rate_hz, delay_s=config.delay_s)


def _start(config: StartConfig, folder: Path) -> dict[str, Any]:
    """The fields of a scenario that its registration starts from."""
    mr, tracker, touched = config.landmarks_mr, config.landmarks_tracker, config.touched
    return {
        "start": None
        if config.transform is None
        else read_transform(folder / config.transform, "mr", "tracker"),
        "landmarks_mr": None if mr is None else read_landmarks(folder / mr, "mr"),
        "landmarks_tracker": None if tracker is None else read_landmarks(folder / tracker, "tracker"),
        "touched": None if touched is None else read_points(folder / touched, "tracker"),
        "touched_phase": config.touched_phase,
    }


def _fixtures(
    config: SessionConfig, folder: Path, named_by: str
) -> tuple["FixtureSet | None", RetimingName | None]:
    if config.fixtures is None:
        return None, config.retiming
    if isinstance(config.fixtures, str):
        fixtures, retiming = read_fixtures(folder / config.fixtures)
        return fixtures, config.retiming or retiming
    with reading(Path(named_by), "a session's configuration"):
        return FixturesConfig(fixtures=config.fixtures, cap_n=config.cap_n).fixture_set(
            folder
        ), config.retiming
