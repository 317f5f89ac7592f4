"""Recordings of every calibration as the command makes them, shared by all tests that read them back."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app


@pytest.fixture
def drawn() -> None:
    """For a test that looks at the pictures of a registration or a motion."""


@pytest.fixture(autouse=True)
def pages_without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out pictures, except for tests with `drawn`: they take longer than what they show."""
    from matplotlib.figure import Figure

    if "drawn" not in request.fixturenames:
        monkeypatch.setattr("dvf_ig.report.motion.motion_figure", lambda *_: Figure())
        monkeypatch.setattr("dvf_ig.report.style.png_bytes", lambda *_: b"\x89PNG")
        for name in (
            "report.registration.page._planes",
            "report.registration.page._shape",
            "replay.page.registration_page.registration_view",
        ):
            monkeypatch.setattr(f"dvf_ig.{name}", lambda *_: "")


@pytest.fixture(scope="session")
def calibration_recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of each kind, only to be read."""
    folder = tmp_path_factory.mktemp("calibrations")
    for kind in ("pivot", "nwire", "cross-wire", "wall", "watertank"):
        words = ["synth", "calibration", kind, "-o", str(folder / kind), "--seed", "5"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    return folder
