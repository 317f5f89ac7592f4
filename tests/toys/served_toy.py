"""The toy's patient in place of what a configuration of `dvf-ig serve` names."""

import pytest
from toy_session import ECG_HZ, toy_setup

from dvf_ig.cli.serve.setup import LiveSetup
from dvf_ig.core import Preop, Rigid
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.live import EcgFieldConfig, LiveConfig
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.readers import StartFiles


def ready(live: LiveConfig) -> LiveSetup:
    setup = toy_setup()
    held = setup.calibrations
    files = SessionFiles(
        preop=PreopFiles(Preop("ball"), setup.heart.model),
        probe=held.probe_from_image,
        latency=held.lag_s,
        tip=held.tip,
        start=StartFiles(setup.start),
        live=live,
    )
    start = setup.start or Rigid.identity("mr", "tracker")
    return LiveSetup(files, setup, None, calibrate(files.calibrations, 0), start, (), "toy")


def serve_toy(patch: pytest.MonkeyPatch) -> None:
    """Let `serve` take the toy's patient, whatever its configuration names."""
    live = LiveConfig(ecg=EcgFieldConfig(rate_hz=ECG_HZ))
    files = ready(live).files
    patch.setattr("dvf_ig.intake.read_session", lambda *_: files)
    patch.setattr("dvf_ig.cli.serve.command.live_setup", lambda *_: ready(live))
    patch.setattr("dvf_ig.live.page.feed.scene_payload", lambda _: {})
