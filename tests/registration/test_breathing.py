"""Pose in breathing: learnt from noisy beats as well as theory says, honest about itself, and on real MR."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.breathing.breaths import BreathSpec, draw_breaths
from data_synth.breathing.motion import breathing_of
from data_synth.breathing.recorded import recorded_breathing
from dvf_ig.cardiac.respiration.breath_clock import BreathClock
from dvf_ig.core import HEART_RADIUS_MM, FloatArray, InvalidInputError, Rigid
from dvf_ig.registration import BeatMeasurement, BreathBeat, OscillationWatch, learn_breathing
from dvf_ig.registration.tracking.pose_estimate import MEAN_SQUARE_OF_COORDINATES
from dvf_ig.registration.unfollowed_breathing import Oscillation
from dvf_ig.study.breathing import true_xi_mm

WARM_S, BREATH_S, BEAT_S, AHEAD_S = 20.0, 60.0 / 14.0, 0.86, 0.06
NOISE_MM = 1.0 / np.sqrt(MEAN_SQUARE_OF_COORDINATES.sum())
"""Of each coordinate, so that the RMS over the heart is 1 mm."""
AXES = np.concatenate([np.eye(3), -np.eye(3), np.ones((1, 3)) / np.sqrt(3), -np.ones((1, 3)) / np.sqrt(3)])
VENTILATED = BreathSpec("ventilated", excursion_mm=10.0)
HOME = Rigid.identity("mr", "tracker")


def learnt(breaths: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Learn, then follow a minute: (n, k) errors over the heart, (n, 6) errors of ξ and their sigma.

    The motion counts from rest, where the heart is taken to lie as it does in the mean.
    """
    rng, until_s = np.random.default_rng([seed, breaths]), WARM_S + breaths * BREATH_S
    breathing = breathing_of(VENTILATED, draw_breaths(VENTILATED, until_s + 60.0, rng), np.zeros(3), rng)
    assert breathing is not None

    def still(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.repeat(np.eye(3)[None], len(t_s), axis=0), np.zeros((len(t_s), 3))

    recorded = recorded_breathing(breathing, still, until_s + 60.0, rng)["respiration"]
    clock, pushed = BreathClock(), int(np.searchsorted(recorded.t_s, until_s))
    clock.push(recorded.t_s[:pushed], recorded.values[:pushed])
    beats = []
    for begin_s in np.arange(WARM_S, until_s - BEAT_S, BEAT_S).tolist():
        frames_s = begin_s + np.arange(10) / 12.0
        xi = true_xi_mm(breathing, frames_s).mean(axis=0) + NOISE_MM * rng.standard_normal(6)
        s, known = clock.features(frames_s), np.eye(6) / NOISE_MM**2
        breath = int((begin_s - WARM_S) / BREATH_S)
        beats.append(BreathBeat(s.mean(axis=0), s, known, known @ xi, breath))
    model = learn_breathing(tuple(beats))
    assert model is not None
    t_s = np.arange(until_s, until_s + 59.0, 0.1)
    rest, rest_level = clock.rest_features(0.3), clock.rest_level(0.3)
    past_s = np.arange(WARM_S, until_s, 0.1)
    resting = clock.features(past_s)[:, 1:].max(axis=1) <= rest_level
    rest_mm = true_xi_mm(breathing, past_s[resting]).mean(axis=0)
    xi, sigma = np.empty((len(t_s), 6)), np.empty((len(t_s), 6))
    for k, now_s in enumerate(t_s.tolist()):
        due = max(pushed, int(np.searchsorted(recorded.t_s, now_s - AHEAD_S, side="right")))
        clock.push(recorded.t_s[pushed:due], recorded.values[pushed:due])
        pushed = due
        s = clock.features(np.array([now_s])) - rest
        xi[k], sigma[k] = rest_mm + model.xi_mm(s)[0], np.sqrt(np.diag(model.covariance_mm2(s)[0]))
    moved = breathing.points_at(HEART_RADIUS_MM * AXES, t_s)
    turn = Rotation.from_rotvec(xi[:, :3] / HEART_RADIUS_MM).as_matrix()
    back = np.einsum("nij,nkj->nki", turn, moved) + xi[:, None, 3:]
    apart = np.linalg.norm(back - HEART_RADIUS_MM * AXES, axis=2)
    return apart, xi - true_xi_mm(breathing, t_s), sigma


@pytest.mark.parametrize(("breaths", "p95_mm"), [(5, 1.7), (20, 1.2)])
def test_errors_after_some_breaths_and_their_sigma(breaths: int, p95_mm: float) -> None:
    parts = [learnt(breaths, seed) for seed in range(3)]
    errors, off, sigma = (np.concatenate([part[k] for part in parts]) for k in range(3))
    assert np.percentile(errors, 95) < p95_mm
    assert 0.6 < np.sqrt(np.mean(off**2) / np.mean(sigma**2)) < 1.4


def test_too_few_beats_teach_nothing_and_broken_ones_are_refused() -> None:
    one = BreathBeat(np.ones(4), np.ones((2, 4)), np.eye(6), np.zeros(6), 1)
    assert learn_breathing((one,) * 5) is None
    broken = BreathBeat(np.full(4, np.nan), np.ones((2, 4)), np.eye(6), np.zeros(6), 1)
    with pytest.raises(InvalidInputError, match="leave the beat out"):
        learn_breathing((broken,) * 20)


FRAME_S = 1.0 / 3.0
PATCHES = {
    "eth_2_sq_sl010_sag_Xcs125": ((170, 225, 80, 140), (95, 150, 65, 130)),
    "eth_4_sq_sl014_sag_Xcs165": ((185, 235, 140, 205), (95, 190, 95, 190)),
}
"""Rows and columns of a patch with the liver's dome, and of one with the heart."""


def followed_px(images: FloatArray, patch: tuple[int, int, int, int], reach: int = 16) -> FloatArray:
    """Follow a patch of the first image along the rows by normalised correlation, to parts of a pixel."""
    top, bottom, left, right = patch
    first = images[0, top:bottom, left:right]
    first = (first - first.mean()) / first.std()
    out = []
    for image in images:
        parts = np.stack([image[top + k : bottom + k, left:right] for k in range(-reach, reach + 1)])
        parts = (parts - parts.mean(axis=(1, 2), keepdims=True)) / parts.std(axis=(1, 2), keepdims=True)
        alike = (parts * first).mean(axis=(1, 2))
        k = int(np.clip(alike.argmax(), 1, 2 * reach - 1))
        bend = alike[k - 1] - 2 * alike[k] + alike[k + 1]
        out.append(k - reach + 0.5 * (alike[k - 1] - alike[k + 1]) / bend)
    return np.array(out)


@pytest.mark.parametrize("name", sorted(PATCHES))
def test_a_real_heart_follows_the_dome_of_the_liver(name: str, data_dir: Path) -> None:
    images = np.load(data_dir / "breathing-mr" / f"{name}.npz")["images"].astype(np.float64)
    dome, heart = (followed_px(images, patch) for patch in PATCHES[name])
    t_s = FRAME_S * np.arange(len(images))
    clock = BreathClock()
    clock.push(t_s, dome[:, None])
    s, half = clock.features(t_s), len(images) // 2
    sigma_px = 0.2
    known = np.diag([0.0] * 5 + [sigma_px**-2])
    beats = tuple(
        BreathBeat(s[k], s[k : k + 1], known, known @ (heart[k] * np.eye(6)[5]), k // 12)
        for k in range(30, half)
    )
    model = learn_breathing(beats)
    assert model is not None
    later = np.arange(half, len(images))
    missed = heart[later] - model.xi_mm(s[later])[:, 5]
    still = heart[later] - heart[30:half].mean()
    rms, before = np.sqrt((missed**2).mean()), np.sqrt((still**2).mean())
    stated = 2.0 * np.sqrt(model.covariance_mm2(s[later])[:, 5, 5] + sigma_px**2)
    assert rms < 0.35 * before, f"{rms:.2f} of {before:.2f} px"
    # single images also move with the heartbeat: 88 % and 95 % of them lie within two standard deviations
    assert np.mean(np.abs(missed) <= stated) > 0.85


def watched(
    move: Callable[[float], FloatArray], beats: int, *, irregular: float = 0.03, seed: int = 3
) -> tuple[list[float], list[Oscillation | None]]:
    """Watch beats of a heart with 0.6 mm of noise a coordinate; times, and what was found after each.

    The probe sweeps to and fro in 9 s.
    """
    rng, t_s, watch = np.random.default_rng(seed), 0.0, OscillationWatch(np.zeros(3))
    times, found = [], []
    for _ in range(beats):
        t_s += 0.85 * max(0.4, 1.0 + irregular * rng.standard_normal())
        information = np.eye(6) / 0.6**2
        offset = move(t_s) + 0.6 * rng.standard_normal(6)
        measured = SimpleNamespace(
            pose=HOME, informative=True, information=information, offset_information_mm=information @ offset
        )
        swept = 2.0 * np.pi * t_s / 9.0
        view_mm = np.eye(3) * 20.0 + [30.0 * np.sin(swept), 20.0 * np.cos(swept), 0.0]
        watch.add(t_s, cast("BeatMeasurement", measured), view_mm)
        times.append(t_s)
        found.append(watch.found)
    return times, found


def shifted(along_mm: float) -> FloatArray:
    return np.array([0.0, 0.0, 0.0, 0.0, -0.3, -0.95]) * along_mm


@pytest.mark.parametrize("irregular", [0.03, 0.18], ids=["sinus", "atrial fibrillation"])
def test_beats_show_a_heart_that_moves_with_the_breath(irregular: float) -> None:
    """4 mm from end to end; then the breath is held."""

    def move(t_s: float) -> FloatArray:
        return shifted(4.0 * np.sin(np.pi * t_s / 4.3) ** 2 if t_s < 60.0 else 0.0)

    times, found = watched(move, 120, irregular=irregular)
    first = next(i for i, one in enumerate(found) if one is not None)
    assert times[first] < 30.0
    for at, one in zip(times, found, strict=True):
        if times[first] < at < 60.0:
            assert one is not None
            assert one.per_minute == pytest.approx(14.0, abs=1.5)
            assert 2.0 * one.amplitude_mm == pytest.approx(4.0, abs=1.2)
    assert found[-1] is None


@pytest.mark.parametrize(
    "move",
    [
        lambda t: shifted(0.0),
        lambda t: shifted(0.15 * t),
        lambda t: shifted(0.75 * np.sin(4 * np.pi * t / 9.0)),
    ],
    ids=["still", "creeps 9 mm/min", "biased by the sweep"],
)
def test_beats_of_a_heart_that_does_not_breathe_show_no_breath(move: Callable[[float], FloatArray]) -> None:
    for seed in range(2):
        for irregular in (0.03, 0.18):
            assert not any(watched(move, 80, irregular=irregular, seed=seed)[1])


def test_a_shift_of_the_patient_is_no_breath_and_breathing_is_found_across_it() -> None:
    """8 mm at 30 s; the session reports it three beats later."""

    def found_of(breath_mm: float) -> list[Oscillation | None]:
        rng, watch, found = np.random.default_rng(0), OscillationWatch(np.zeros(3)), []
        for k in range(60):
            t_s = 0.85 * k
            moved = shifted(8.0 * (t_s > 30.0) + breath_mm * np.sin(np.pi * t_s / 4.3) ** 2)
            offset = moved + 0.6 * rng.standard_normal(6)
            measured = SimpleNamespace(
                pose=HOME, informative=True, information=np.eye(6) / 0.36, offset_information_mm=offset / 0.36
            )
            watch.add(t_s, cast("BeatMeasurement", measured), np.zeros((3, 3)))
            if k == 38:
                watch.shifted(30.0)
            found.append(watch.found)
        return found

    assert not any(found_of(0.0))
    assert found_of(5.0)[-1] is not None
