"""Hearts for the tests of the synthetic world: one phantom for all that only look at it, a ball for rules."""

import numpy as np
import pytest
from toy_sphere import sphere

import data_synth.scenario.live as live_module
import data_synth.scenario.recording as scenario_module
from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.tissue import Tissue
from dvf_ig.core import CycleTiming, FloatArray, Landmarks, Points, Preop, SurfaceSeries

BALL_CENTER_MM = np.array([40.0, -25.0, 60.0])


class Ball:
    """A beating ball with everything that a scenario asks of an anatomy, except ultrasound."""

    rr_s = 0.86
    es_fraction = 0.36

    def __init__(self) -> None:
        self.unit, self.surface_triangles = sphere(1.0, 1)

    @property
    def box_mm(self) -> FloatArray:
        return BALL_CENTER_MM + np.array([[-50.0], [50.0]])

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return BALL_CENTER_MM + self.unit * (50.0 - 5.0 * np.sin(np.pi * model_phase) ** 2)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        return np.full(len(xyz_mm), int(Tissue.MEDIASTINUM))

    def targets(self) -> Landmarks:
        return self.landmarks()

    def landmarks(self) -> Landmarks:
        points = BALL_CENTER_MM + 50.0 * np.vstack([np.eye(3), -np.eye(3)])
        return Landmarks(tuple("abcdef"), Points("mr", points))

    def preop(self) -> Preop:
        series = SurfaceSeries(
            "EPICARDIAL",
            "mr",
            np.stack([self.surface_vertices(i / 5) for i in range(5)]),
            self.surface_triangles,
            CycleTiming.uniform(5, self.rr_s),
            "ball",
        )
        return Preop("ball", surfaces=(series,))


@pytest.fixture(scope="session")
def anatomy() -> PhantomAnatomy:
    """Physiological motion, 1.2 mm mismatch, seed 1; its grids are built once."""
    return phantom_anatomy(motion="physiological", mismatch_mm=1.2, seed=1)


@pytest.fixture(scope="session")
def ball() -> Ball:
    return Ball()


@pytest.fixture
def on_a_ball(monkeypatch: pytest.MonkeyPatch, ball: Ball) -> None:
    """Scenarios are made on the ball, with black images."""
    monkeypatch.setattr(scenario_module, "phantom_anatomy", lambda **_: ball)
    monkeypatch.setattr(scenario_module, "cine_preop", lambda *_: ball.preop())
    monkeypatch.setattr(scenario_module, "surface_anatomy", lambda *_, **__: ball)
    monkeypatch.setattr(
        live_module,
        "simulate_sequence",
        lambda anatomy, probe, poses, phases, **_: np.zeros(
            (len(poses), probe.rows, probe.columns), dtype=np.uint8
        ),
    )
    monkeypatch.setattr(live_module, "degraded", lambda images, *_: images)
