"""Hearts that something was tuned on are never reported; a start has exactly the error that was asked for."""

import json
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose
from toy_volume import toy_volume

from data_synth import SecondWorldSpec
from dvf_ig.core import InvalidInputError, Landmarks, Points, Preop, TrackedVolume, VolumeSeries
from dvf_ig.registration import pose_difference, target_errors_mm
from dvf_ig.study.hearts import recordings
from dvf_ig.study.hearts.recordings import HEART_LISTS, REPORTED, Truth, heart_list, start_with_error
from dvf_ig.study.hearts.study import heart_trial

TARGETS = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-45, 45, (27, 3)))
KNOWN = Truth(toy_pose(), TARGETS, CENTER_MM)


def test_no_heart_is_in_two_lists() -> None:
    lists = list(HEART_LISTS.values())
    for hearts in ("first_world", "second_world", "changed", "patients", "stacks"):
        named = [heart for one in lists for heart in getattr(one, hearts)]
        assert len(named) == len(set(named))


def test_the_second_world_is_for_reporting_alone() -> None:
    assert len(REPORTED.second_world) >= 40
    assert not any(one.second_world for one in HEART_LISTS.values() if one is not REPORTED)


def test_an_unknown_list_is_refused_by_name() -> None:
    with pytest.raises(InvalidInputError, match="'secret'; choose from tuning, threshold, reported"):
        heart_list("secret")


def test_hearts_of_the_second_world_are_reported_alone() -> None:
    assert REPORTED.of_world("second", "sweep-of-sax") == REPORTED.second_world
    for images in ("sweep-of-sax", "sweep-of-sax+lax"):
        assert REPORTED.of_world("first", images).start > REPORTED.of_world("first", "sweep").start
    with pytest.raises(InvalidInputError, match="no hearts of the second world"):
        heart_list("tuning").of_world("second", "sweep")


@pytest.mark.parametrize("start_mm", [0.5, 2.0, 8.0, 20.0, 90.0])
def test_a_start_has_exactly_the_mean_error_asked_for(start_mm: float) -> None:
    starts = [start_with_error(KNOWN, start_mm, np.random.default_rng(seed)) for seed in range(40)]
    errors = [target_errors_mm(start, toy_pose(), TARGETS).mean() for start in starts]
    np.testing.assert_allclose(errors, start_mm, rtol=1e-9)
    turns, shifts = zip(*(pose_difference(s, toy_pose(), CENTER_MM) for s in starts), strict=True)
    lengths = np.linalg.norm(np.array(shifts), axis=1)
    # some are nearly all rotation, some nearly all shift, and no two are equal
    assert max(turns) <= 180.0
    assert lengths.min() < 0.5 * start_mm
    assert lengths.max() > 0.9 * start_mm
    assert len({s.matrix.tobytes() for s in starts}) == len(starts)


def test_a_start_may_be_the_truth() -> None:
    at_truth = start_with_error(KNOWN, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(at_truth.matrix, toy_pose().matrix, atol=1e-9)


class ToyPair:
    """The toy heart in place of a phantom: two views, still through the cycle."""

    def __init__(self, spec: Any) -> None:
        mr = toy_mr()
        codes = np.where(mr.values > 200, 2, np.where(mr.values < 130, 1, 0)).astype(np.uint8)
        self.spec, self.mr_from_tracker, self.center_mm = spec, toy_pose(), CENTER_MM
        self.targets = Landmarks(tuple(f"t{i}" for i in range(len(TARGETS))), TARGETS)
        self.preop = Preop(
            "toy",
            mr=mr,
            labels=VolumeSeries(mr.grid, codes, mr.timing),
            label_names=((1, "wall"), (2, "blood")),
            organ_labels=(1, 2),
        )

    def volumes(self, phases: tuple[float, ...], phase_error: float = 0.0) -> tuple[TrackedVolume, ...]:
        turns = ((0.5, 0.2, -0.4), (-0.6, 0.9, 0.3))
        seen = [toy_volume(turn, seed) for turn, seed in zip(turns, (1, 101), strict=True)]
        return tuple(replace(view, model_phase=phase) for view, phase in product(seen, phases))


def test_a_trial_measures_the_registration_of_gated_volumes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "image_pair", ToyPair)
    recordings._preoperative.cache_clear()
    settings = {"world": "first", "images": "volumes", "qualities": ["calm"], "disturbed": 0, "changes": []}
    line = heart_trial(settings, 700)
    recordings._preoperative.cache_clear()
    assert (line["heart"], line["quality"], line["disturbed"]) == (7, "calm", False)
    assert 4.0 <= line["start_mm"] <= 12.0
    assert line["tre_mm"] <= line["tre_max_mm"] < 1.0
    json.dumps(line, allow_nan=False)


def test_hearts_of_the_second_world_are_examined_too(monkeypatch: pytest.MonkeyPatch) -> None:
    examined = []

    def recording(spec: SecondWorldSpec, phases: int) -> None:
        examined.append((spec.exam, phases))
        raise InvalidInputError("enough")

    monkeypatch.setattr(recordings, "second_world_recording", recording)
    for images in ("sweep-of-sax+lax", "sweep"):
        settings = {
            "world": "second", "images": images, "qualities": ["calm"], "disturbed": 0, "changes": []
        }  # fmt: skip
        assert "enough" in heart_trial(settings, 408100)["refused"]
    assert examined == [("sax+lax", recordings.EXAM_PHASES), (None, recordings.EXAM_PHASES)]
