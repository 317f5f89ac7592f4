"""A live session's setup from what its configuration names: calibrate, build the heart, find the start."""

from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.cli.patient_model import patient_model

if TYPE_CHECKING:
    from dvf_ig.cardiac import RetimeMode
    from dvf_ig.core import Landmarks
    from dvf_ig.guidance import FixtureSet
    from dvf_ig.io import LivePatient
    from dvf_ig.session import SessionSetup


def read_patient(config: Path) -> "LivePatient":
    """Of a SESSION.yaml, or of a scenario folder whose recording is streamed."""
    from dvf_ig.io import live_patient_of_scenario, read_live_patient, read_scenario_session

    if config.is_dir():
        return live_patient_of_scenario(read_scenario_session(config, truth=False), config)
    return read_live_patient(config)


def live_setup(
    patient: "LivePatient",
    model: Path | None,
    fixtures: "FixtureSet",
    retiming: "RetimeMode",
    seed: int,
) -> "tuple[SessionSetup, tuple[Landmarks, Landmarks] | None, str]":
    """The setup, landmarks that were touched before (None where a start pose takes their place), and a line
    that says where the model is from."""
    from dvf_ig.replay.calibrations import calibrate
    from dvf_ig.replay.start import landmarks_start, require_start, start_pose
    from dvf_ig.session import EcgSource, SessionSetup, build_heart

    require_start(patient)
    used = calibrate(patient, seed).in_use
    built, origin = patient_model(patient.preop, patient.model or model)
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
    return setup, landmarks, origin
