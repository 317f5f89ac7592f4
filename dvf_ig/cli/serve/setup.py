"""A live session's setup from what its configuration names: calibrate, build the heart, find the start."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.cli.patient_model import patient_model

if TYPE_CHECKING:
    from dvf_ig.cardiac import RetimeMode
    from dvf_ig.core import Landmarks, Rigid
    from dvf_ig.guidance import FixtureSet
    from dvf_ig.intake.agreement.finding import Finding
    from dvf_ig.intake.live_read import LivePatient
    from dvf_ig.replay.calibrations import Calibrations
    from dvf_ig.session import SessionSetup


def read_patient(config: Path) -> "LivePatient":
    """Of a SESSION.yaml, or of a scenario folder whose recording is streamed."""
    from dvf_ig.intake.live_read import live_patient_of_scenario, read_live_patient
    from dvf_ig.intake.scenario.read import read_scenario_session

    if config.is_dir():
        return live_patient_of_scenario(read_scenario_session(config, truth=False), config)
    return read_live_patient(config)


@dataclass(frozen=True, slots=True, eq=False)
class LiveSetup:
    """What a live session is begun with.

    Attributes:
        landmarks: touched before; None where a start pose takes their place.
        calibrations: in use, with their evidence.
        start: coarse mr_from_tracker that registration starts from.
        findings: in what the files disagree, though they can be used.
        origin: a line that says where the model is from.
    """

    patient: "LivePatient"
    setup: "SessionSetup"
    landmarks: "tuple[Landmarks, Landmarks] | None"
    calibrations: "Calibrations"
    start: "Rigid"
    findings: "tuple[Finding, ...]"
    origin: str


def live_setup(
    patient: "LivePatient",
    model: Path | None,
    fixtures: "FixtureSet",
    retiming: "RetimeMode",
    seed: int,
) -> LiveSetup:
    """The setup of a session whose files agree.

    Raises:
        DvfIgError: the first reason why they cannot be used, or not together.
    """
    from dvf_ig.intake.fit import require_live_fit
    from dvf_ig.replay.calibrations import calibrate
    from dvf_ig.replay.start import landmarks_start, require_start, start_pose
    from dvf_ig.session import EcgSource, SessionSetup, build_heart

    require_start(patient)
    calibrations = calibrate(patient, seed)
    used = calibrations.in_use
    built, origin = patient_model(patient.preop, patient.model or model)
    findings = require_live_fit(patient, built, used.probe_from_image, used.lag_s, used.tip)
    heart = build_heart(patient.preop, built)
    start = start_pose(patient, heart, seed)
    by_landmarks = landmarks_start(patient)
    setup = SessionSetup(
        heart,
        used,
        EcgSource(patient.live.ecg.rate_hz),
        start=None if by_landmarks else start,
        fan=patient.fan,
        fixtures=fixtures,
        retiming=retiming,
        seed=seed,
    )
    landmarks = None
    if by_landmarks and patient.landmarks_mr is not None and patient.landmarks_tracker is not None:
        landmarks = (patient.landmarks_mr, patient.landmarks_tracker)
    return LiveSetup(patient, setup, landmarks, calibrations, start, findings, origin)
