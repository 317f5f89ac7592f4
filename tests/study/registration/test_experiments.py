"""Experiments of the registration protocol: every trial once, starts as asked, the pipeline's own error."""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

import dvf_ig.study.registration.problem as problems
import dvf_ig.study.registration.trial as trials
from dvf_ig.core import InvalidInputError, Points, Rigid, Stop, VolumeSeries
from dvf_ig.registration import (
    Level,
    RegistrationData,
    RegistrationOptions,
    RegistrationResult,
    channels_from_mr,
    pose_difference,
    register_rigid,
    target_errors_mm,
)
from dvf_ig.study.registration.experiments import (
    BIN_MM,
    CAPTURE,
    EXPERIMENTS,
    FAILURES,
    FAR_MM,
    MOTIONS,
    SAME_IMAGE,
    CaptureOptions,
    Experiment,
    settings_of,
    trial_numbers,
    trials_per_heart,
)
from dvf_ig.study.registration.problem import GATED, RegistrationProblem
from dvf_ig.study.registration.summary import summarise_trials
from dvf_ig.study.registration.trial import registration_trial, start_with_error
from dvf_ig.study.trials import Study, run_trials

TARGETS = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-45, 45, (27, 3)))
OFFSET_MM = 0.7


@lru_cache(maxsize=1)
def any_result() -> RegistrationResult:
    """A registration of the toy heart: what the stub's results say besides their pose."""
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.1)
    level = Level(slices, channels_from_mr(toy_mr(), smoothing_mm=3.0), 3.0)
    options = RegistrationOptions(starts=1)
    data = RegistrationData(level, level, CENTER_MM)
    return register_rigid(data, toy_pose(), rng=np.random.default_rng(0), clock=perf_counter, options=options)


def stub_problem(pair: int, condition: dict[str, Any]) -> RegistrationProblem:
    """Registration that always ends OFFSET_MM from the truth, and refuses starts of the pair 13."""

    def register(start: Rigid, rng: np.random.Generator) -> RegistrationResult:
        if pair == 13:
            raise InvalidInputError("pair 13 is refused")
        off = toy_pose().perturbed_left([0, 0, 0], [0.0, OFFSET_MM, 0.0], CENTER_MM)
        found = any_result()
        evidence = replace(found.evidence, split_half_mm=np.inf)
        return replace(found, target_from_source=off, stop=Stop.CONVERGED, evidence=evidence)

    return RegistrationProblem(toy_pose(), TARGETS, CENTER_MM, register)


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


def test_pairs_have_numbers_of_their_own() -> None:
    settings = settings_of(FAILURES)
    one, next_ones, all_of_them = (trial_numbers(settings, *which) for which in ((1, 1), (2, 3), (1, 4)))
    assert [*one, *next_ones] == list(all_of_them)


def test_conditions_have_names_that_tell_them_apart() -> None:
    for experiment in EXPERIMENTS:
        conditions = settings_of(experiment, CaptureOptions(("calm", "poor-image")))["conditions"]
        labels = [(c["motion"], c["quality"], c["condition"]) for c in conditions]
        assert len(set(labels)) == len(conditions), experiment.name
        assert Counter(c["motion"] for c in conditions)[MOTIONS[0]] == len(conditions) / 2


def test_starts_of_the_capture_experiment_fill_every_bin() -> None:
    starts = settings_of(CAPTURE, CaptureOptions(per_bin=4, to_mm=10.0))["starts_mm"]
    assert Counter(tuple(s) for s in starts) == {
        (low, low + BIN_MM): 4 for low in np.arange(0.0, 10.0, BIN_MM)
    }
    assert [s[0] for s in settings_of(FAILURES)["starts_mm"]] == list(FAR_MM)


def test_baselines_start_after_ours_and_need_a_volume(asked: list[tuple[int, str]]) -> None:
    settings = settings_of(CAPTURE, CaptureOptions(per_bin=1, to_mm=4.0, baseline=True))
    assert settings_of(CAPTURE)["baseline_starts_mm"] == []
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


def toy_pair(spec: Any) -> SimpleNamespace:
    mr = toy_mr()
    codes = 1 + (mr.values > mr.values.mean()).astype(np.uint8)
    preop = SimpleNamespace(
        mr=mr,
        labels=VolumeSeries(mr.grid, codes, mr.timing),
        label_names=((1, "wall"), (2, "blood")),
        organ_labels=(1, 2),
    )
    points = SimpleNamespace(points=TARGETS)
    return SimpleNamespace(
        spec=spec, preop=preop, targets=points, center_mm=CENTER_MM, mr_from_tracker=toy_pose()
    )


@pytest.mark.parametrize("number", [0, 5])
def test_the_same_image_is_found_to_a_twentieth_of_a_millimetre(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Same image on the toy heart: what the way through tracker, planes and search costs."""
    monkeypatch.setattr(problems, "image_pair", toy_pair)
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()
    line = registration_trial(settings_of(SAME_IMAGE), number)
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()
    assert line["start_mm"] > 2.0
    assert line["tre_mm"] < 0.05
    assert line["rotation_deg"] < 0.05


@pytest.mark.parametrize("es_fraction", [0.3, 0.36, 0.42])
def test_retiming_is_without_error_at_the_models_own_rate(es_fraction: float) -> None:
    pair: Any = SimpleNamespace(before=SimpleNamespace(rr_s=0.86, es_fraction=es_fraction))
    np.testing.assert_allclose(problems._retiming_error(pair, 0.86), np.zeros(len(GATED)), atol=1e-9)
    fast, slow = problems._retiming_error(pair, 0.6), problems._retiming_error(pair, 1.2)
    systole = np.abs(np.array(GATED) - es_fraction).argmin()
    # at a fast rate its systole is the shorter one, so that it is ahead at end-systole; and the other way
    assert 0.005 < fast[systole] < 0.1
    assert -0.1 < slow[systole] < -0.005
    assert np.abs([fast[0], slow[0]]).max() < 1e-3, "R peaks agree"
