"""The toy's patient in place of what a configuration of `dvf-ig serve` names."""

from pathlib import Path

import pytest
from toy_session import ECG_HZ, toy_setup

from dvf_ig.cli.serve.setup import LiveSetup
from dvf_ig.core import Preop, Rigid
from dvf_ig.intake.live import EcgFieldConfig, LiveConfig
from dvf_ig.intake.live_read import LivePatient
from dvf_ig.replay.calibrations import calibrate


def ready(live: LiveConfig) -> LiveSetup:
    setup = toy_setup()
    held = setup.calibrations
    patient = LivePatient(
        preop=Preop("ball"),
        model=setup.heart.model,
        probe=held.probe_from_image,
        latency=held.lag_s,
        tip=held.tip,
        fan=None,
        start=setup.start,
        landmarks_mr=None,
        landmarks_tracker=None,
        touched=None,
        touched_phase=None,
        fixtures=None,
        retiming=None,
        live=live,
        folder=Path(),
    )
    start = setup.start or Rigid.identity("mr", "tracker")
    return LiveSetup(patient, setup, None, calibrate(patient, 0), start, (), "toy")


def serve_toy(patch: pytest.MonkeyPatch) -> None:
    """Let `serve` take the toy's patient, whatever its configuration names."""
    live = LiveConfig(ecg=EcgFieldConfig(rate_hz=ECG_HZ))
    patient = ready(live).patient
    patch.setattr("dvf_ig.cli.serve.command.read_patient", lambda _: patient)
    patch.setattr("dvf_ig.cli.serve.command.live_setup", lambda *_: ready(live))
    patch.setattr("dvf_ig.live.page.feed.scene_payload", lambda _: {})
