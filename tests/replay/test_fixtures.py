"""The fixtures and the law of retiming that a replay is given: they reach the force, and score it."""

import dataclasses

import numpy as np
import pytest
from dvf_ig.replay.forces import force_samples
from dvf_ig.replay.gated_frames import UltrasoundRecording, gate_recording
from dvf_ig.replay.schedule import suspended_at

from dvf_ig.cardiac import beat_phase
from dvf_ig.core import InvalidInputError, Scenario
from dvf_ig.guidance import (
    FORBIDDEN_SURFACE,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    PathTarget,
    Sigmoid,
    static_force,
)
from dvf_ig.replay import Replay, result_of, run_replay
from dvf_ig.replay.report import report_html
from dvf_ig.replay.result import true_contact


def with_fixtures(replay: Replay, fixtures: FixtureSet) -> Replay:
    """The same estimates, and the force that they give with other fixtures."""
    track = replay.phase_tracking.track
    suspended = suspended_at(replay.history.updates, track.t_s)
    bound = Fixtures(replay.heart.model, fixtures)
    samples, valid = force_samples(
        bound, replay.poses, suspended, replay.tip, replay.model_phase, track.valid
    )
    return dataclasses.replace(replay, fixtures=fixtures, samples=samples, valid=valid)


def test_a_replay_without_fixtures_has_the_forbidden_surface(replay: Replay) -> None:
    again = with_fixtures(replay, FORBIDDEN_SURFACE)
    assert replay.fixtures == FORBIDDEN_SURFACE
    np.testing.assert_array_equal(again.samples.force_n, replay.samples.force_n)
    np.testing.assert_array_equal(again.samples.status, replay.samples.status)


def test_dynamic_guidance_is_scored_against_guidance(replay: Replay) -> None:
    """Eqs 7–9 at every tick: |F(d)n − F(d')n'| <= K|d − d'| + cap·|n − n'|, with d/|∇d| for a blend's d."""
    law = Gaussian(3.0, 1.0)
    guided = with_fixtures(replay, FixtureSet((FixtureOptions(law, "distance"),)))
    distance_mm, true_force = true_contact(guided)
    truth = replay.scenario.truth
    assert truth is not None
    assert true_force is not None
    to_tracker = truth.mr_from_tracker_at(0.0).rotation
    halfway_s = (truth.tool.t_s[1:] + truth.tool.t_s[:-1]) / 2
    nearest = np.searchsorted(halfway_s, guided.tip.t_s)
    sure = np.abs(guided.tip.t_s - halfway_s[np.minimum(nearest, len(halfway_s) - 1)]) > 1e-6
    sure &= np.abs(guided.tip.t_s - halfway_s[np.maximum(nearest - 1, 0)]) > 1e-6
    normal = truth.tool.normal[nearest]
    expected = static_force(law, truth.tool.distance_mm[nearest], normal) @ to_tracker
    np.testing.assert_allclose(true_force[sure], expected[sure], atol=1e-12)
    samples, ok = guided.samples, guided.valid
    norm = np.linalg.norm(samples.gradient, axis=1)
    ok = ok & sure & (norm > 0.4)
    apart_mm = np.abs(samples.distance_mm / norm - distance_mm)
    turned = np.linalg.norm(samples.gradient / norm[:, None] - normal @ to_tracker, axis=1)
    error_n = np.linalg.norm(samples.force_n - true_force, axis=1)
    assert (error_n <= law.stiffness_n_per_mm * apart_mm + law.cap_n * turned + 1e-9)[ok].all()
    contact = guided.valid & (distance_mm >= 0.0)
    result, before = result_of(guided), result_of(replay)
    assert result["force_error_n"]["median"] == pytest.approx(np.median(error_n[contact]))
    assert (before["fixtures"][0]["law"], before["retiming"]) == ("forbidden", "two-segment")
    assert result["fixtures"] == [FixtureOptions(law, "distance").described()]
    assert result["contact"] == before["contact"]
    assert result["tre_mm"] == before["tre_mm"]
    outside = ok & (samples.distance_mm < -1.0)
    inward = np.einsum("ij,ij->i", samples.force_n[outside], samples.gradient[outside])
    assert outside.any()
    assert (inward > 0).all(), "guidance pulls to the surface from outside too"


def test_a_path_has_no_true_force(replay: Replay) -> None:
    """Contact with the organ is scored all the same."""
    center = replay.heart.center_mm
    path = PathTarget.static("mr", [center, center + 10.0])
    guide = FixtureOptions(Gaussian(3.0, 1.0), path=path)
    few = dataclasses.replace(replay, tip=dataclasses.replace(replay.tip, valid=_every(replay, 50)))
    for fixtures in (FixtureSet((FixtureOptions(Sigmoid()), guide)), FixtureSet((guide,))):
        along = with_fixtures(few, fixtures)
        result = result_of(along)
        assert along.samples.force_n.any()
        assert result["force_error_n"] is None
        assert result["contact"]["served_share"] > 0.0
        assert true_contact(along)[1] is None
    assert report_html(along, result).count("data:image/png;base64,") == 6


def _every(replay: Replay, n: int) -> np.ndarray:
    """One tick in n, where the tool is tracked: paths take long."""
    return np.asarray(replay.tip.valid & (np.arange(len(replay.tip.valid)) % n == 0))


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
    calibrations, peaks = replay.calibrations, replay.phase_tracking.peaks
    head = (replay.scenario, replay.heart, peaks, calibrations.latency.lag_s)
    found = {}
    for mode in ("uniform", "two-segment"):
        recording = UltrasoundRecording(*head, calibrations.probe.probe_from_image, mode)
        found[mode] = gate_recording(recording, from_s=2.0, until_s=8.0)
    beat = beat_phase(np.array([p.t_s for p in peaks if p.detected_at_s <= 8.0]), found["uniform"].event_s)
    known = np.isfinite(beat.rr_s)
    assert known.any()
    np.testing.assert_array_equal(found["uniform"].model_phase[known], beat.phi[known] % 1.0)
    assert np.abs(found["two-segment"].model_phase - found["uniform"].model_phase)[known].max() > 1e-4
