"""Read every recording that a session's configuration names."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvf_ig.core.errors import DvfIgError, UnreadableFileError
from dvf_ig.core.model import DvfModel
from dvf_ig.core.recordings.scenario import Scenario
from dvf_ig.core.recordings.sequence import TrackedSequence
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.intake.calibration import read_latency_source, read_probe_source, read_tip_source
from dvf_ig.intake.fixtures import FixturesConfig, RetimingName, margin_options, read_fixtures
from dvf_ig.intake.missing import NEEDS, REQUIRED
from dvf_ig.intake.named_files import require_files
from dvf_ig.intake.parts import read_session_ecg, read_start, read_sweep, read_tool
from dvf_ig.intake.preop import read_preop
from dvf_ig.intake.problem import in_keys
from dvf_ig.intake.schema import SCHEMA, SessionConfig, SessionDraft
from dvf_ig.io.plus.names import ProbeNames
from dvf_ig.io.reading import reading
from dvf_ig.io.truth import read_truth
from dvf_ig.io.yaml_config import read_yaml, validated

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet
    from dvf_ig.intake.live_record import LiveRecord


@dataclass(frozen=True, slots=True, eq=False)
class SessionRecordings:
    """What a session's configuration names, read.

    Attributes:
        scenario: every recording.
        model: of the patient, where a file holds it.
        fixtures: None where the configuration describes none.
        retiming: how the beat is mapped to the model's cycle; None where it does not say.
        named_patient: as of `PreopFiles`.
        live: what repeats a live session, of its record; None of other recordings.
    """

    scenario: Scenario
    model: DvfModel | None
    fixtures: "FixtureSet | None"
    retiming: RetimingName | None
    named_patient: str | None = None
    live: "LiveRecord | None" = None


def read_session_config(path: Path | str) -> SessionConfig:
    """Parse and check a SESSION.yaml; the files that it names are not opened.

    Raises:
        UnreadableFileError: absent, not YAML, unknown keys, or missing or wrong values.
    """
    path = Path(path)
    document = read_document(path)
    needs = (need for need in NEEDS if need.key in REQUIRED and need.absent_from(document))
    lacking = [f"{need.key}: {need.sentence}" for need in needs]
    if lacking:
        raise UnreadableFileError(f"{path} lacks {'; '.join(lacking)}")
    return validated(SessionConfig, document, path)


def read_session_draft(path: Path | str) -> SessionDraft:
    """The same of a configuration that may still lack parts.

    Raises:
        UnreadableFileError: as `read_session_config`.
    """
    path = Path(path)
    return validated(SessionDraft, read_document(path), path)


def read_document(path: Path) -> dict[str, Any]:
    """The keys of a SESSION.yaml with a value: a section of which every line is commented out is not given.

    Raises:
        UnreadableFileError: absent, not YAML, or of another schema.
    """
    document = read_yaml(path, "a session's configuration")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else None
        hint = "give its folder" if got == "dvf_ig.scenario/1" else "begin one with: dvf-ig config init"
        raise UnreadableFileError(f"{path} has schema '{got}'; needed '{SCHEMA}': {hint}")
    return {key: value for key, value in document.items() if value is not None}


def read_session(path: Path | str) -> SessionRecordings:
    """Read a SESSION.yaml and every file that it names.

    Raises:
        UnreadableFileError: a file is absent (all absent ones are named) or cannot be read.
        InvalidInputError: files that do not fit each other.
        QualityGateError: a calibration that was refused.
    """
    path = Path(path)
    config = read_session_config(path)
    try:
        return read_recordings(config, path.parent, str(path))
    except DvfIgError as error:
        raise type(error)(in_keys(str(error))) from error


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
    path = folder / config.ultrasound.file
    sweep = read_sweep(path, names)
    tool = read_tool(config.tool, folder, sweep)
    calibration, fan = config.calibration, config.ultrasound.fan
    start = read_start(config.start, folder)
    tip = None
    if calibration.tip is not None:
        tip = read_tip_source(calibration.tip, folder, "tool" if tool is None else tool.source)
    scenario = Scenario(
        name=config.name or files.preop.patient_id,
        preset=config.preset,
        preop=files.preop,
        ecg=read_session_ecg(config.ecg, folder, path),
        ultrasound=_ultrasound(sweep.recorded, sweep.probe),
        fan=None if fan is None else fan.fan(),
        probe=read_probe_source(calibration.probe, folder, names),
        latency=read_latency_source(calibration.latency, folder, names),
        tool=None if tool is None else replace(tool, target="tracker", source="tool"),
        tracked_against=sweep.probe.target,
        tip=tip,
        start=start.start,
        landmarks_mr=start.landmarks_mr,
        landmarks_tracker=start.landmarks_tracker,
        touched=start.touched,
        touched_phase=config.start.touched_phase,
        seed=config.seed,
        truth=None if config.truth is None else read_truth(folder / config.truth),
    )
    fixtures, retiming = read_session_fixtures(config, folder, named_by)
    return SessionRecordings(scenario, files.model, fixtures, retiming, files.named_patient)


def _ultrasound(recorded: TrackedSequence, probe: PoseStream) -> TrackedSequence:
    """The same with one stream, tracker_from_probe, whatever the recording calls the two."""
    named = replace(probe, target="tracker", source="probe")
    return replace(recorded, poses={named.name: named})


def read_session_fixtures(
    config: SessionConfig | SessionDraft, folder: Path, named_by: str
) -> tuple["FixtureSet | None", RetimingName | None]:
    """Fixtures and retiming that a configuration states or names; None where it leaves them open.

    Raises:
        UnreadableFileError: values out of range, or a joint cap or a device beside the name of a file, which
            says them itself.
    """
    margin = config.margin
    if all(given is None for given in (config.fixtures, config.cap_n, config.device, margin)):
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
        return fixtures, config.retiming or retiming
    with reading(Path(named_by), "a session's configuration"):
        of_session = FixturesConfig(
            fixtures=FixturesConfig().fixtures if config.fixtures is None else config.fixtures,
            cap_n=config.cap_n,
            device=config.device,
            margin="off" if margin is None else margin,
        )
        return of_session.fixture_set(folder), config.retiming
