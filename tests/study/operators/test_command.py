"""`dvf-ig study operators` from the command line, on a ball in place of the phantom."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from toy_sphere import sphere
from typer.testing import CliRunner

from data_synth.operator.contact import MovingSurface
from dvf_ig.cli.main import app
from dvf_ig.core import CycleTiming, FloatArray, SurfaceSeries
from dvf_ig.preop import ModelOptions, model_from_surfaces
from dvf_ig.study.operators import closed_loop, tasks
from dvf_ig.study.tracking.stylus import BeatingSurface


class Ball:
    """Drawn back by up to 3 mm once a cycle."""

    def __init__(self) -> None:
        self.unit, self.surface_triangles = sphere(1.0, 3)

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return np.asarray(self.unit * (30.0 - 3.0 * np.sin(np.pi * model_phase) ** 2))


def beating_ball(*_: object, **__: object) -> BeatingSurface:
    ball, timing = Ball(), CycleTiming.uniform(8, 0.6)
    vertices = np.stack([ball.surface_vertices(phase) for phase in timing.fractions])
    series = SurfaceSeries("EPICARDIAL", "mr", vertices, ball.surface_triangles, timing, "ball")
    model = model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=5.0, margin_mm=10.0))
    return BeatingSurface("paper5mm", MovingSurface.of(ball), model, vertices[0][:2], np.full(2, 3.0))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(closed_loop, "beating_surface", beating_ball)
    monkeypatch.setattr(tasks, "CYCLES", 4)
    closed_loop.surface_of.cache_clear()
    yield
    closed_loop.surface_of.cache_clear()


@pytest.mark.usefixtures("small")
def test_tracking_tells_its_assumptions_and_writes_summary_and_figure(tmp_path: Path) -> None:
    asked = [
        "study",
        "operators",
        "--task",
        "tracking",
        "--seeds",
        "3",
        "--workers",
        "1",
        "-o",
        str(tmp_path),
    ]
    done = CliRunner().invoke(app, [*asked, "--json"])
    assert done.exit_code == 0, done.output
    assert "assumed: Simulated operators: no person took part." in done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["operators"] == 3
    without, felt, unattended = (row["measures"]["mean_mm"]["value"] for row in summary["rows"])
    assert felt < unattended < without
    assert summary["automatic"]["mean_mm"] < without
    assert summary["paper"]["automatic"] == "0.29 mm mean"
    first = summary["differences"][0]
    assert first["mean"]["value"] == pytest.approx(felt - without)
    assert first["effect_size"]["value"] < -1.0
    assert (tmp_path / "tracking.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 3
