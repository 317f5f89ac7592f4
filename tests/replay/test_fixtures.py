"""The fixtures and the law of retiming that a replay is given: they reach the force, and score it."""

import dataclasses

import numpy as np
import pytest
from readable_fixtures import DISTANCE, FORCE, GRADIENT, TICK_OUTPUT, TickedFixtures

from dvf_ig.cardiac import beat_phase
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, Scenario
from dvf_ig.guidance import (
    FORBIDDEN_SURFACE,
    Evaluator,
    FixtureOptions,
    FixtureSet,
    Gaussian,
    PathTarget,
    Sigmoid,
    Status,
    static_force,
)
from dvf_ig.guidance.margins import MarginOptions
from dvf_ig.replay import Replay, result_of, run_replay
from dvf_ig.replay.page.replay_page import report_html
from dvf_ig.replay.result.errors import true_contact
from dvf_ig.session import UltrasoundRecording, gate_recording


def with_fixtures(replay: Replay, fixtures: FixtureSet, every: int = 1) -> tuple[Replay, FloatArray]:
    """The same estimates with the force that other fixtures give, sent as wanted; (n, 3) gradients.

    Args:
        every: only one tick in so many is given a force: paths take long.
    """
    ticks, bound = replay.ticks, TickedFixtures(replay.heart.model, fixtures)
    out = np.full((len(ticks), TICK_OUTPUT), np.nan)
    out[:, FORCE] = 0.0
    status = np.full(len(ticks), int(Status.STALE_TOOL))
    tips = np.array(ticks.tip_tracker_mm)
    for i in np.flatnonzero(ticks.valid)[::every].tolist():
        pose, phase = ticks.mr_from_tracker[i], float(ticks.model_phase[i])
        status[i] = bound.tick(pose, tips[i], phase, int(Status.OK), out[i])
    force = out[:, FORCE]
    given = dataclasses.replace(
        ticks, force_n=force, wanted_n=force, distance_mm=out[:, DISTANCE], status=status
    )
    setup = dataclasses.replace(replay.setup, fixtures=fixtures)
    return dataclasses.replace(replay, ticks=given, setup=setup), out[:, GRADIENT]


def readable_force(replay: Replay) -> tuple[FloatArray, IntArray]:
    """(n, 3) force of the forbidden surface through the changes of shape that are followed, and its status.

    d'(q) = d(q − m(q)) acts as d' |∇d| / |∇d'| along (I − Dm)ᵀ ∇d.
    """
    ticks, law = replay.ticks, FORBIDDEN_SURFACE.fixtures[0].law
    force, status = np.zeros((len(ticks), 3)), np.full(len(ticks), int(Status.STALE_TOOL))
    updates = [update for update in replay.history.updates if update.pose is not None]
    in_force = np.searchsorted([update.from_s for update in updates], ticks.t_s, side="right") - 1
    for number, update in enumerate(updates):
        here = np.flatnonzero(ticks.valid & (in_force == number))
        if not len(here):
            continue
        poses = ticks.mr_from_tracker[here]
        places = np.einsum("nij,nj->ni", poses[:, :, :3], ticks.tip_tracker_mm[here]) + poses[:, :, 3]
        slope = np.zeros((len(here), 3, 3))
        if update.warp is not None:
            slope, places = update.warp.slope(places), update.warp.model_places(places)
        wall = Evaluator(replay.heart.model, law).force(places, ticks.model_phase[here])
        gradient = wall.gradient - np.einsum("nij,ni->nj", slope, wall.gradient)
        stretch = np.linalg.norm(wall.gradient, axis=1) / np.linalg.norm(gradient, axis=1)
        in_model = static_force(law, stretch * wall.distance_mm, gradient)
        force[here], status[here] = np.einsum("nji,nj->ni", poses[:, :, :3], in_model), wall.status
    return force, status


def test_a_replay_without_fixtures_has_the_forbidden_surface(replay: Replay) -> None:
    assert replay.setup.fixtures == FORBIDDEN_SURFACE
    valid = replay.ticks.valid
    expected, status = readable_force(replay)
    np.testing.assert_array_equal(status[valid], replay.ticks.status[valid])
    # the servo takes the tip over to a new pose in 5 ms, and damps
    apart = np.linalg.norm(expected[valid] - replay.ticks.wanted_n[valid], axis=1)
    assert np.median(apart) < 0.002
    assert apart.max() < 0.05


def test_a_margin_is_reported_with_the_depth_that_it_leaves(replay: Replay) -> None:
    off = result_of(replay)["margin"]
    assert (off["mode"], off["median_mm"]) == ("off", 0.0)
    ticks = dataclasses.replace(replay.ticks, margin_mm=np.full(len(replay.ticks), 0.3))
    options = dataclasses.replace(FORBIDDEN_SURFACE, margin=MarginOptions("fixed", fixed_mm=0.3))
    setup = dataclasses.replace(replay.setup, fixtures=options)
    found = result_of(dataclasses.replace(replay, ticks=ticks, setup=setup))["margin"]
    assert (found["mode"], found["median_mm"], found["p95_mm"]) == ("fixed", 0.3, 0.3)
    for figure in ("p95", "max"):
        less = max(0.0, off["violation_mm"][figure] - 0.3)
        assert found["violation_mm"][figure] == pytest.approx(less, abs=1e-9)


def test_dynamic_guidance_is_scored_against_guidance(replay: Replay) -> None:
    """Eqs 7–9 at every tick: |F(d)n − F(d')n'| <= K|d − d'| + cap·|n − n'|, with d/|∇d| for a blend's d."""
    law = Gaussian(3.0, 1.0)
    guided, gradient = with_fixtures(replay, FixtureSet((FixtureOptions(law, "distance"),)))
    distance_mm, true_force = true_contact(guided)
    truth = replay.scenario.truth
    assert truth is not None
    assert true_force is not None
    to_tracker = truth.mr_from_tracker_at(0.0).rotation
    halfway_s = (truth.tool.t_s[1:] + truth.tool.t_s[:-1]) / 2
    nearest = np.searchsorted(halfway_s, guided.ticks.t_s)
    sure = np.abs(guided.ticks.t_s - halfway_s[np.minimum(nearest, len(halfway_s) - 1)]) > 1e-6
    sure &= np.abs(guided.ticks.t_s - halfway_s[np.maximum(nearest - 1, 0)]) > 1e-6
    normal = truth.tool.normal[nearest]
    expected = static_force(law, truth.tool.distance_mm[nearest], normal) @ to_tracker
    np.testing.assert_allclose(true_force[sure], expected[sure], atol=1e-12)
    ticks, ok = guided.ticks, guided.ticks.valid
    norm = np.linalg.norm(gradient, axis=1)
    ok = ok & sure & (norm > 0.4)
    apart_mm = np.abs(ticks.distance_mm / norm - distance_mm)
    turned = np.linalg.norm(gradient / norm[:, None] - normal @ to_tracker, axis=1)
    error_n = np.linalg.norm(ticks.force_n - true_force, axis=1)
    assert (error_n <= law.stiffness_n_per_mm * apart_mm + law.cap_n * turned + 1e-9)[ok].all()
    contact = guided.ticks.valid & guided.ticks.guided & (distance_mm >= 0.0)
    result, before = result_of(guided), result_of(replay)
    assert result["force_error_n"]["median"] == pytest.approx(np.median(error_n[contact]))
    assert (before["fixtures"][0]["law"], before["retiming"]) == ("forbidden", "two-segment")
    assert result["fixtures"] == [FixtureOptions(law, "distance").described()]
    sent_later = 2.0 / before["contact"]["ticks"]  # a supervised force begins one tick later
    assert result["contact"]["ticks"] == before["contact"]["ticks"]
    assert result["contact"]["served_share"] == pytest.approx(
        before["contact"]["served_share"], abs=sent_later
    )
    assert result["contact"]["known_share"] == 1.0
    assert result["contact"]["served_known_share"] == result["contact"]["served_share"]
    assert result["tre_mm"] == before["tre_mm"]
    outside = ok & (ticks.distance_mm < -1.0)
    inward = np.einsum("ij,ij->i", ticks.force_n[outside], gradient[outside])
    assert outside.any()
    assert (inward > 0).all(), "guidance pulls to the surface from outside too"


@pytest.mark.usefixtures("blank_pictures")
def test_a_path_has_no_true_force(replay: Replay) -> None:
    """Contact with the organ is scored all the same."""
    center = replay.heart.center_mm
    path = PathTarget.static("mr", [center, center + 10.0])
    guide = FixtureOptions(Gaussian(3.0, 1.0), path=path)
    for fixtures in (FixtureSet((FixtureOptions(Sigmoid()), guide)), FixtureSet((guide,))):
        along, _ = with_fixtures(replay, fixtures, every=50)
        result = result_of(along)
        assert along.ticks.force_n.any()
        assert result["force_error_n"] is None
        assert result["contact"]["served_share"] > 0.0
        assert true_contact(along)[1] is None
    assert report_html(along, result).count("data:image/png;base64,") == 7


def test_what_a_replay_is_given_reaches_it(
    scenario: Scenario, replay: Replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvf_ig.replay.engine.calibrate", lambda *_: replay.calibrations)
    monkeypatch.setattr("dvf_ig.replay.engine.build_heart", lambda *_, **__: replay.heart)
    stiff = FixtureSet((FixtureOptions(Sigmoid(3.0), name="epicardium"),))
    with pytest.raises(InvalidInputError, match=r"fixture 'epicardium': .*450 N/m at its steepest"):
        run_replay(scenario, model=replay.heart.model, fixtures=stiff)
    with pytest.raises(InvalidInputError, match="retiming 'linear' is unknown"):
        run_replay(scenario, model=replay.heart.model, retiming="linear")


def test_ultrasound_is_placed_by_the_same_law_of_retiming(replay: Replay) -> None:
    """Uniform: the phase of the beat itself; two-segment: another where the rate is not the model's."""
    peaks, setup = tuple(replay.history.peaks), replay.setup
    head = (replay.scenario.ultrasound, 0, setup.fan, setup.heart, peaks, setup.calibrations)
    found = {}
    for mode in ("uniform", "two-segment"):
        recording = UltrasoundRecording(*head, mode)
        found[mode] = gate_recording(recording, from_s=2.0, until_s=8.0)
    beat = beat_phase(np.array([p.t_s for p in peaks if p.detected_at_s <= 8.0]), found["uniform"].event_s)
    known = np.isfinite(beat.rr_s)
    assert known.any()
    np.testing.assert_array_equal(found["uniform"].model_phase[known], beat.phi[known] % 1.0)
    assert np.abs(found["two-segment"].model_phase - found["uniform"].model_phase)[known].max() > 1e-4
