"""Breathing: rests at end-expiration, keeps its excursion and rate, and is undone exactly by its inverse."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.breathing.breaths import BreathSpec, draw_breaths, with_backlash
from data_synth.breathing.motion import Breathing, ShapedAnatomy, breathing_of
from dvf_ig.core import FloatArray, InvalidInputError

CENTER = np.array([10.0, -20.0, 30.0])
TIMES = np.arange(0.0, 90.0, 0.01)
VENTILATED = BreathSpec("ventilated", excursion_mm=10.0)


def made(spec: BreathSpec = VENTILATED) -> Breathing:
    rng = np.random.default_rng(3)
    breathing = breathing_of(spec, draw_breaths(spec, 90.0, rng), CENTER, rng)
    assert breathing is not None
    return breathing


def lift_mm(spec: BreathSpec = VENTILATED) -> FloatArray:
    """Distance of the heart's centre from its rest."""
    breathing = made(spec)
    turn, shift = breathing.mr_from_rest(TIMES)
    return np.asarray(np.linalg.norm(turn @ CENTER + shift - CENTER, axis=1))


def breaths_per_min(lift: FloatArray) -> float:
    up = np.flatnonzero((lift[1:] >= 5.0) & (lift[:-1] < 5.0))
    return float(60.0 * (len(up) - 1) / (TIMES[up[-1]] - TIMES[up[0]]))


def test_a_ventilated_heart_keeps_its_excursion_rate_and_rest() -> None:
    lift = lift_mm()
    assert np.percentile(lift, 2) < 0.5
    assert lift.max() == pytest.approx(10.0, rel=0.1)
    assert breaths_per_min(lift) == pytest.approx(14.0, abs=0.3)


@pytest.mark.parametrize(
    ("event", "low_mm", "high_mm"), [("sigh", 15.0, 20.0), ("pause", 0.0, 0.7), ("disconnection", 1.0, 2.0)]
)
def test_events_show_in_the_motion(event: str, low_mm: float, high_mm: float) -> None:
    changed = lift_mm(replace(VENTILATED, events=((event, 40.0),)))
    window = (
        changed[(TIMES > 40.0) & (TIMES < 49.5)] if event == "sigh" else changed[np.abs(TIMES - 50.0) < 1.0]
    )
    assert low_mm <= window.max() <= high_mm


def test_the_rate_doubles_and_a_cough_is_quick() -> None:
    doubled = lift_mm(replace(VENTILATED, events=(("doubled-rate", 0.0),)))
    assert breaths_per_min(doubled) == pytest.approx(28.0, abs=0.6)
    calm, cough = lift_mm(), lift_mm(replace(VENTILATED, events=(("cough", 40.0),)))
    apart = np.abs(cough - calm)
    assert apart[np.abs(TIMES - 40.5) < 1.0].max() > 3.0
    assert apart[TIMES < 39.0].max() < 0.1


def test_shape_changes_are_undone_exactly_and_have_their_stated_size() -> None:
    breathing = made()
    rest = CENTER + 40.0 * np.random.default_rng(0).standard_normal((500, 3)) / np.sqrt(3)
    t_s = np.array([51.3])
    share = float(breathing.share_at(t_s)[0])

    class Still:
        inverse_motion = property(lambda self: self)

        def pull_back(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
            return xyz_mm

    turn, shift = breathing.mr_from_rest(t_s)
    shaped = (breathing.points_at(rest, t_s)[0] - shift[0]) @ turn[0]
    anatomy = ShapedAnatomy(Still(), share, breathing.shape)
    assert np.abs(anatomy.pull_back(shaped, 0.0) - rest).max() < 1e-5
    rms = np.sqrt((breathing.shape.at(rest) ** 2).sum(axis=1).mean())
    assert rms == pytest.approx(np.hypot(0.55, 0.3), rel=0.35)


def test_backlash_is_the_same_at_every_rate() -> None:
    slow = np.sin(np.linspace(0, 12, 1200))
    assert np.allclose(with_backlash(slow, 0.2)[::2], with_backlash(slow[::2], 0.2), atol=0.01)
    assert np.ptp(with_backlash(slow, 0.2)) == pytest.approx(1.8, abs=0.01)


def test_no_breathing_without_excursion_and_bad_ones_are_refused() -> None:
    rng = np.random.default_rng(0)
    assert breathing_of(BreathSpec(), draw_breaths(BreathSpec(), 10.0, rng), CENTER, rng) is None
    with pytest.raises(InvalidInputError, match="needed 0 to 40 mm"):
        BreathSpec(excursion_mm=-1.0)
    with pytest.raises(InvalidInputError, match="no event 'hiccup'"):
        BreathSpec(events=(("hiccup", 1.0),))
