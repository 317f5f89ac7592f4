"""Trials of the registration experiments: each once, started as asked, its error measured; resumable."""

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stub_registration import OFFSET_MM, TARGETS, any_result, stub_problem
from toy_heart import CENTER_MM, toy_pose

import dvf_ig.study.registration.trial as trials
from dvf_ig.core import Rigid
from dvf_ig.registration import (
    pose_difference,
    target_errors_mm,
)
from dvf_ig.study.registration.experiments import (
    CAPTURE,
    EXPERIMENTS,
    FAILURES,
    FAR_MM,
    MOTIONS,
    PLANES,
    SAME_IMAGE,
    CaptureOptions,
    Experiment,
    settings_of,
    trial_numbers,
    trials_per_heart,
)
from dvf_ig.study.registration.problem import RegistrationProblem
from dvf_ig.study.registration.summary import summarise_trials
from dvf_ig.study.registration.trial import registration_trial, start_with_error
from dvf_ig.study.trials import Study, run_trials


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, str]]]:
    """Registration problems are stubs; the (pair, condition) they were asked for."""
    calls: list[tuple[int, str]] = []

    def make(pair: int, condition: dict[str, Any]) -> RegistrationProblem:
        calls.append((pair, json.dumps(condition)))
        return stub_problem(pair, condition)

    trials._problem.cache_clear()
    monkeypatch.setattr(trials, "make_problem", make)
    yield calls
    trials._problem.cache_clear()


def mean_error(pose: Rigid) -> float:
    return float(target_errors_mm(pose, toy_pose(), TARGETS).mean())


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda e: e.name)
def test_every_pair_condition_and_start_is_one_trial(
    experiment: Experiment, asked: list[tuple[int, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    starts: list[tuple[int, str, float]] = []

    def start_asked(problem: RegistrationProblem, start_mm: float, rng: np.random.Generator) -> Rigid:
        starts.append((*asked[-1], start_mm))
        return problem.truth

    monkeypatch.setattr(trials, "start_with_error", start_asked)
    settings = settings_of(experiment, CaptureOptions(("calm", "poor-image"), 2, 8.0))
    numbers = trial_numbers(settings, 3, 2)
    lines = [registration_trial(settings, number) for number in numbers]
    conditions = [json.dumps(c) for c in settings["conditions"]]
    assert len(set(conditions)) == len(conditions)
    assert asked == list(product((3, 4), conditions)), "each problem once, its trials one after the other"
    bounds, together = settings["starts_mm"], trials_per_heart(settings)
    assert len(numbers) == 2 * len(conditions) * len(bounds)
    assert together == len(conditions) // len(MOTIONS) * len(bounds)
    for first in range(0, len(numbers), together):
        group = starts[first : first + together]
        assert len({(pair, json.loads(said)["motion"]) for pair, said, _ in group}) == 1
    for first in range(0, len(numbers), len(bounds)):
        group = starts[first : first + len(bounds)]
        assert len({(pair, condition) for pair, condition, _ in group}) == 1
        for (low, high), (_, _, start_mm) in zip(bounds, group, strict=True):
            assert low <= start_mm <= high
    for line, (pair, condition, _) in zip(lines, starts, strict=True):
        said = json.loads(condition)
        assert (line["pair"], line["arm"], line["method"]) == (pair, experiment.letter, "dvf_ig")
        assert all(line[name] == said[name] for name in ("motion", "quality", "condition"))


def test_baselines_start_after_ours_and_need_a_volume(asked: list[tuple[int, str]]) -> None:
    settings = settings_of(CAPTURE, CaptureOptions(per_bin=1, to_mm=4.0, baseline=True))
    assert settings_of(CAPTURE)["baseline_starts_mm"] == []
    assert settings_of(PLANES, CaptureOptions(baseline=True))["baseline_starts_mm"] == []
    assert trials_per_heart(settings) == 4
    ours = [registration_trial(settings, number)["method"] for number in range(2)]
    assert ours == ["dvf_ig"] * 2
    with pytest.raises(TypeError, match="baseline"):
        registration_trial(settings, 2)


@pytest.mark.parametrize("start_mm", [0.5, 2.0, 8.0, 20.0, 90.0])
def test_a_start_has_exactly_the_mean_error_asked_for(start_mm: float) -> None:
    problem = stub_problem(1, {})
    starts = [start_with_error(problem, start_mm, np.random.default_rng(seed)) for seed in range(40)]
    np.testing.assert_allclose([mean_error(s) for s in starts], start_mm, rtol=1e-9)
    turns, shifts = zip(*(pose_difference(s, toy_pose(), CENTER_MM) for s in starts), strict=True)
    lengths = np.linalg.norm(np.array(shifts), axis=1)
    # some are nearly all rotation, some nearly all shift, and none of them alike
    assert max(turns) <= 180.0
    assert lengths.min() < 0.5 * start_mm
    assert lengths.max() > 0.9 * start_mm
    assert len({s.matrix.tobytes() for s in starts}) == len(starts)


def test_a_start_may_be_the_truth_or_far_off(asked: list[tuple[int, str]]) -> None:
    at_truth = start_with_error(stub_problem(1, {}), 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(at_truth.matrix, toy_pose().matrix, atol=1e-9)
    settings = settings_of(FAILURES)
    lines = [registration_trial(settings, n) for n in range(len(FAR_MM))]
    assert [line["start_mm"] for line in lines] == pytest.approx(list(FAR_MM), rel=1e-9)


def test_a_line_says_how_far_off_the_result_is(asked: list[tuple[int, str]]) -> None:
    settings = settings_of(FAILURES)
    line = registration_trial(settings, 5)
    assert line["tre_mm"] == pytest.approx(OFFSET_MM, rel=1e-9)
    assert line["rotation_deg"] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(np.abs(line["translation_mm"]), [0.0, OFFSET_MM, 0.0], atol=1e-9)
    assert line["usable"] is True
    assert line["halves_mm"] is None, "no number in JSON for what is without bound"
    assert line["sigma_mm"] == pytest.approx(
        np.sqrt(np.trace(np.diag([1600.0] * 3 + [1.0] * 3) @ any_result().covariance) / 6)
    )
    json.dumps(line, allow_nan=False)
    assert registration_trial(settings, 5) == line, "the same number, the same trial"


def test_a_refusal_keeps_its_labels_and_is_counted(asked: list[tuple[int, str]]) -> None:
    settings = settings_of(SAME_IMAGE)
    lines = [registration_trial(settings, n) for n in trial_numbers(settings, 12, 2)]
    refused = [line for line in lines if "refused" in line]
    assert [line["pair"] for line in refused] == [13] * 6
    assert {line["refused"] for line in refused} == {"pair 13 is refused"}
    groups = summarise_trials([{"seed": i, **line} for i, line in enumerate(lines)])
    assert [(g.motion, g.n, g.refused, g.success.count) for g in groups] == [(m, 6, 3, 3) for m in MOTIONS]


def test_a_stopped_study_goes_on_with_what_is_missing(asked: list[tuple[int, str]], tmp_path: Path) -> None:
    settings = settings_of(SAME_IMAGE)
    study = Study("registration", settings, registration_trial)
    numbers, together = trial_numbers(settings, 1, 2), trials_per_heart(settings)
    whole = run_trials(study, numbers, tmp_path, group_size=together)
    path = tmp_path / "trials.jsonl"
    kept = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(kept[:4]) + kept[4][:-9])
    trials._problem.cache_clear()
    asked.clear()
    assert run_trials(study, numbers, tmp_path, group_size=together) == whole
    assert [pair for pair, _ in asked] == [1, 2, 2]
    assert path.read_bytes() == b"".join(kept)
