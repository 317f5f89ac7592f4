"""What a replay must catch: a probe whose marker slips, a wrong probe calibration.

A patient who moves: `test_pose_tracker`; on images `dvf-ig study replay --preset patient-shift` measures it.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from data_synth.heart.heart_spec import HeartSpec
from data_synth.mr.cine import cine_preop
from data_synth.scenario.presets import ScenarioSpec
from data_synth.scenario.recording import ImagedHeart, phantom_scenario
from data_synth.seeds import child_rng
from dvf_ig.core import BoolArray, DvfModel, Scenario, ScenarioTruth, Stop
from dvf_ig.guidance import Hazard
from dvf_ig.guidance.supervision.supervisor import FADE_S
from dvf_ig.replay import Replay, run_replay
from dvf_ig.replay.result.pose import suspensions, withheld_spans, without_force_s
from dvf_ig.session import Refusal


def disturbed(imaged: ImagedHeart, preset: str, seconds: float, **more: Any) -> Scenario:
    heart = HeartSpec(anatomy_seed=77, motion_seed=77)
    spec = ScenarioSpec(preset, motion="paper5mm", seconds=seconds, heart=heart, **{"seed": 77, **more})
    return phantom_scenario(spec, imaged=imaged)


@pytest.fixture(scope="module")
def model(replay: Replay) -> DvfModel:
    return replay.heart.model


def truth_of(replay: Replay) -> ScenarioTruth:
    assert replay.scenario.truth is not None
    return replay.scenario.truth


def between(replay: Replay, begin_s: float, end_s: float) -> BoolArray:
    return np.asarray((replay.ticks.t_s >= begin_s) & (replay.ticks.t_s < end_s))


def beats_until(replay: Replay, from_s: float, until_s: float) -> int:
    """True R peaks after `from_s`, to `until_s`."""
    peaks = truth_of(replay).r_peaks_s
    return int(((peaks > from_s) & (peaks <= until_s)).sum())


def test_after_the_marker_slips_on_the_probe_no_force_is_given_again(
    imaged: ImagedHeart, model: DvfModel
) -> None:
    # MR as fine as a study's, and another seed: else breathing is excluded only after the slip
    studied = replace(imaged, preop=cine_preop(imaged.anatomy, child_rng(imaged.spec.seeds.anatomy, "preop")))
    replay = run_replay(disturbed(studied, "probe-slip", 24.0, seed=78, us_rate_hz=9.0), model=model, seed=0)
    end_s = float(replay.ticks.t_s[-1])
    slipped_s = truth_of(replay).later_probe_from_image[0][0]
    assert replay.ticks.force_n[between(replay, 0.0, slipped_s)].any()
    ((stopped_s, resumed_s),) = suspensions(tuple(replay.history.updates), end_s)
    assert slipped_s < stopped_s
    assert beats_until(replay, slipped_s, stopped_s) <= 2
    assert resumed_s == end_s
    after = [attempt for attempt in replay.attempts if attempt.asked_s > slipped_s]
    assert len(after) >= 2
    assert not any(attempt.usable for attempt in after)
    assert {one.refused.cause for one in after if one.refused is not None} <= {Refusal.BEAT_DISAGREES}
    assert not replay.ticks.force_n[between(replay, stopped_s + FADE_S + 0.001, np.inf)].any()
    *_, last = withheld_spans(replay)
    assert last.begin_s == pytest.approx(stopped_s, abs=0.002)
    assert (last.end_s, last.rule) == (end_s, "contradicted")
    assert without_force_s(replay.ticks) >= end_s - stopped_s - FADE_S


def test_a_pose_withheld_for_the_breath_is_not_said_to_lack_beats() -> None:
    posed = np.array([True, True, False, False, True])
    ticks = SimpleNamespace(
        t_s=np.arange(5.0),
        mr_from_tracker=np.where(posed, 1.0, np.nan)[:, None, None] * np.ones((5, 3, 4)),
        hazards=np.where(posed, Hazard.NONE, Hazard.BREATHING),
        pose_age_s=np.zeros(5),
        pose_bound_mm=np.ones(5),
    )
    replay: Any = SimpleNamespace(ticks=ticks, history=SimpleNamespace(updates=[]))
    (span,) = withheld_spans(replay)
    assert (span.begin_s, span.end_s, span.rule) == (2.0, 4.0, "breathing")


def test_a_wrong_probe_calibration_is_refused_by_touched_landmarks(
    imaged: ImagedHeart, model: DvfModel
) -> None:
    replay = run_replay(disturbed(imaged, "wrong-calibration", 12.5, us_rate_hz=9.0), model=model, seed=0)
    assert replay.attempts
    for attempt in replay.attempts:
        assert not attempt.usable
        if attempt.refused is None:  # by its own check of the calibration, before landmarks are compared
            assert attempt.result is not None
            assert attempt.result.stop is Stop.DISAGREEMENT
            assert "calibrate the probe again" in attempt.result.sentence
        else:
            assert attempt.refused.cause is Refusal.LANDMARKS_DISAGREE
    assert not replay.poses
    assert not replay.ticks.force_n.any()
    assert not replay.ticks.valid.any()
