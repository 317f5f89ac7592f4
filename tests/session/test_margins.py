"""Margins in a session: wanted by what it states of pose, phase, tool and tip; reached slowly."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from toy_ball import structure
from toy_session import CENTER, GUIDED_S, run, ticks, tool_events, toy_setup, toy_streams

from dvf_ig.core import RIGID_SIGMA_MM, FloatArray, Rigid, SeenPart
from dvf_ig.guidance import FixtureOptions, FixtureSet, Gaussian, Hazard, Sigmoid, Status
from dvf_ig.guidance.margins import LARGEST_MARGIN_MM, MarginOptions
from dvf_ig.guidance.servo import ServoInputs
from dvf_ig.session import GuidanceState, Session
from dvf_ig.session.margins import TIP_SIGMA_MM, TOOL_SIGMA_MM
from dvf_ig.session.pose_states import AGEING_MM_PER_S

pytestmark = pytest.mark.usefixtures("known_ultrasound")
WALL_AND_GUIDE = (FixtureOptions(Sigmoid()), FixtureOptions(Gaussian(6.0, cap_n=0.3)))


def outside(t_s: float) -> FloatArray:
    """Two to five millimetres outside of the beating ball, never quite at rest."""
    return np.asarray(CENTER + np.array([18.0, 0.3 * np.sin(3.0 * t_s), 0.0]))


def states_with(
    margin: MarginOptions,
    until_s: float = GUIDED_S + 2.0,
    seen: SeenPart | None = None,
    fixtures: tuple[FixtureOptions, ...] = WALL_AND_GUIDE,
) -> list[GuidanceState]:
    streams = toy_streams(until_s)
    streams.tool = tool_events(until_s, at=outside)
    setup = replace(toy_setup(), fixtures=FixtureSet(fixtures, margin=margin))
    heart = replace(setup.heart, model=replace(setup.heart.model, seen=seen))
    setup = replace(setup, heart=heart)
    with Session(setup) as session:
        return run(session, streams.merged(), ticks(GUIDED_S, until_s))


def test_an_adaptive_margin_is_the_quantile_of_all_that_the_session_states() -> None:
    states = states_with(MarginOptions("adaptive", quantile=0.9))
    margins = np.array([s.margin_mm for s in states])
    for state in states[100:]:
        ageing = AGEING_MM_PER_S * state.pose_age_s
        others = RIGID_SIGMA_MM**2 + TIP_SIGMA_MM**2 + TOOL_SIGMA_MM**2 + ageing**2
        size = float(np.linalg.norm(state.gradient))
        wanted = NormalDist().inv_cdf(0.9) * np.sqrt(state.distance_sigma_mm**2 + others * size**2)
        np.testing.assert_allclose(state.margin_mm, wanted, atol=0.05)
    steps = np.diff(margins, axis=0)
    assert (margins[0] == 0.0).all(), "it begins at none"
    stiffness = np.array([one.law.stiffness_n_per_mm for one in WALL_AND_GUIDE])
    assert (np.abs(steps) * stiffness).max() <= 0.1 + 1e-9
    assert margins[-1].min() > 0.5
    assert (
        ServoInputs(
            states[-1].transform, states[-1].now_s, Rigid.identity("tracker", "device"), margin_mm=margins[-1]
        ).margin_mm.tolist()
        == margins[-1].tolist()
    )


def test_where_no_slice_shows_the_heart_there_is_no_force_or_the_largest_margin() -> None:
    phases = toy_setup().heart.model.phases
    elsewhere = np.tile([[200.0, 300.0]], (phases, 1, 1))
    seen = SeenPart(np.array([0.0, 0.0, 1.0]), elsewhere, np.array([200.0, 300.0]), np.zeros(phases))
    for state in states_with(MarginOptions(), seen=seen)[5:]:
        assert state.status is Status.UNSEEN
        assert state.supervised.hazards & Hazard.OUT_OF_VOLUME
        assert not np.asarray(state.force_n).any()
    last = states_with(MarginOptions("adaptive"), seen=seen)[-1]
    assert last.status is Status.OK
    np.testing.assert_allclose(last.margin_mm, LARGEST_MARGIN_MM)


def test_a_margin_widens_the_wall_that_a_session_renders() -> None:
    """Margins off and fixed hold from the first moment on; a fixed one widens the wall by its width."""
    off, fixed = states_with(MarginOptions()), states_with(MarginOptions("fixed", fixed_mm=1.5))
    assert not np.array([s.margin_mm for s in off]).any()
    assert (np.array([s.margin_mm for s in fixed]) == 1.5).all()
    wide = FixtureSet((FixtureOptions(Sigmoid(depth_mm=-1.5)), FixtureOptions(Gaussian(7.5, cap_n=0.3))))
    streams = toy_streams(GUIDED_S + 2.0)
    streams.tool = tool_events(GUIDED_S + 2.0, at=outside)
    with Session(replace(toy_setup(), fixtures=wide)) as session:
        expected = run(session, streams.merged(), ticks(GUIDED_S, GUIDED_S + 2.0))
    np.testing.assert_allclose([s.wanted_n for s in fixed], [s.wanted_n for s in expected], atol=1e-12)
    assert np.abs(fixed[-1].wanted_n - off[-1].wanted_n).max() > 0.02


def test_each_structure_has_the_margin_of_its_own_distance() -> None:
    """A still one has none by the phase; one out of reach has the largest; the heart's is as without them."""
    tip = CENTER + np.array([18.0, 0.0, 0.0])
    soft = Sigmoid(cap_n=0.2)
    still = structure("oesophagus", tip + np.array([0.0, 8.0, 0.0]), 5.0, still=True)
    beating = structure("atrium", tip + np.array([9.0, 0.0, 0.0]), 6.0)
    far = structure("nerve", tip + np.array([0.0, 0.0, 90.0]), 5.0, still=True)
    walls = tuple(FixtureOptions(soft, structure=one) for one in (None, still, beating, far))
    states = states_with(MarginOptions("adaptive", largest_mm=4.0), fixtures=walls)
    alone = states_with(MarginOptions("adaptive", largest_mm=4.0), fixtures=walls[:1])
    heart, of_still, of_beating, of_far = np.array([s.margin_mm for s in states[100:]]).T
    np.testing.assert_allclose(heart, [s.margin_mm[0] for s in alone[100:]], atol=0.05)
    assert (of_far == 4.0).all()
    others = np.sqrt(RIGID_SIGMA_MM**2 + TIP_SIGMA_MM**2 + TOOL_SIGMA_MM**2)
    quantile = NormalDist().inv_cdf(0.95)
    assert (of_still > quantile * others).all()
    assert np.ptp(of_still) < 0.3 * np.ptp(of_beating)
