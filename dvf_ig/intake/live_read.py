"""What a live session needs before its first event: patient, calibrations, start, fixtures, device names."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.core.errors import DvfIgError, InvalidInputError, UnreadableFileError
from dvf_ig.core.model import DvfModel
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.scenario import LatencyRecording, Preop
from dvf_ig.core.recordings.sequence import Fan
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.intake.calibration import read_latency_source, read_probe_source, read_tip_source
from dvf_ig.intake.fixtures import RetimingName
from dvf_ig.intake.live import LiveConfig
from dvf_ig.intake.parts import read_session_ecg, read_start
from dvf_ig.intake.preop import read_preop
from dvf_ig.intake.problem import in_keys
from dvf_ig.intake.read import read_document, read_session_fixtures
from dvf_ig.intake.schema import LiveSessionConfig, SessionConfig
from dvf_ig.io.plus.names import ProbeNames, split_transform
from dvf_ig.io.yaml_config import validated

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet

NO_TIP = "calibration.tip: a force needs a tool tip: dvf-ig calibrate pivot POSES -o tip.json"


@dataclass(frozen=True, slots=True, eq=False)
class LivePatient:
    """What a live session begins with; calibrations, start and landmarks as of `Scenario`.

    Attributes:
        model: of the patient, where a file holds it.
        fixtures, retiming: None where the configuration does not say.
        live: who sends what.
        folder: where names of files begin.
        named_patient: as of `PreopFiles`.
    """

    preop: Preop
    model: DvfModel | None
    probe: NWireRecording | TargetRecording | ImageMap
    latency: LatencyRecording | float
    tip: PoseStream | Points
    fan: Fan | None
    start: Rigid | None
    landmarks_mr: Landmarks | None
    landmarks_tracker: Landmarks | None
    touched: Points | None
    touched_phase: float | None
    fixtures: "FixtureSet | None"
    retiming: RetimingName | None
    live: LiveConfig
    folder: Path
    named_patient: str | None = None


def read_live_patient(path: Path | str) -> LivePatient:
    """Read a SESSION.yaml with a section `live`; recordings that it names besides are not opened.

    Raises:
        UnreadableFileError: a file is absent or cannot be read, or no section `live`.
        InvalidInputError: files that do not fit each other.
        QualityGateError: a calibration that was refused.
    """
    path = Path(path)
    document = read_document(path)
    if "live" not in document:
        raise UnreadableFileError(
            f"{path} has no section 'live', which says who sends what: for example\n"
            "live: {probe: ProbeToTracker, tool: ToolToTracker, image: Image_Tracker, "
            "ecg: {field: EcgData, rate_hz: 500}}"
        )
    config = validated(LiveSessionConfig, document, path)
    try:
        return live_patient(config, path.parent, str(path))
    except DvfIgError as error:
        raise type(error)(in_keys(str(error))) from error


def live_patient(config: LiveSessionConfig, folder: Path, named_by: str) -> LivePatient:
    """The same of a configuration.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    Raises:
        as `read_live_patient`.
    """
    calibration, live = config.calibration, config.live
    if calibration.tip is None:
        raise UnreadableFileError(f"{named_by}: {NO_TIP}")
    tool, probe = split_transform(live.tool), split_transform(live.probe)
    names = ProbeNames() if probe is None else ProbeNames(probe[1])
    fan = None
    if config.ultrasound is not None:
        names = ProbeNames.from_plus(config.ultrasound.probe_name, config.ultrasound.reference_name)
        fan = config.ultrasound.fan
    files = read_preop(config.preop, folder, config.patient_id)
    start = read_start(config.start, folder)
    fixtures, retiming = read_session_fixtures(config, folder, named_by)
    return LivePatient(
        preop=files.preop,
        model=files.model,
        probe=read_probe_source(calibration.probe, folder, names),
        latency=read_latency_source(calibration.latency, folder, names),
        tip=read_tip_source(calibration.tip, folder, "tool" if tool is None else tool[1]),
        fan=None if fan is None else fan.fan(),
        start=start.start,
        landmarks_mr=start.landmarks_mr,
        landmarks_tracker=start.landmarks_tracker,
        touched=start.touched,
        touched_phase=config.start.touched_phase,
        fixtures=fixtures,
        retiming=retiming,
        live=live,
        folder=folder,
        named_patient=files.named_patient,
    )


def live_patient_of_scenario(config: SessionConfig, folder: Path) -> LivePatient:
    """The patient of a scenario folder whose recording is streamed (`dvf-ig synth stream`).

    Args:
        config: of the folder (`read_scenario_session`).
    Raises:
        InvalidInputError: its beats come from a trigger, which is not streamed.
    """
    ecg = read_session_ecg(config.ecg, folder, folder / config.ultrasound.file)
    if isinstance(ecg, TriggerTimes):
        raise InvalidInputError(f"{folder} has a trigger in place of an ECG; a live session takes an ECG")
    document = {**config.model_dump(by_alias=True), "live": {"ecg": {"rate_hz": ecg.rate_hz}}}
    return live_patient(LiveSessionConfig.model_validate(document), folder, str(folder))
