"""Gated volumes and the model's cycle: phase by ECG and heart rate, channels in use, overlap, landmarks."""

import logging
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stub_registration import any_result
from toy_ball import ball_model
from toy_heart import CENTER_MM, toy_mr, toy_pose
from toy_volume import toy_volume

from dvf_ig.cardiac import RPeak, retime
from dvf_ig.core import (
    CycleTiming,
    InvalidInputError,
    NoOverlapError,
    Rigid,
    Stop,
    TrackedVolume,
    VolumeSeries,
)
from dvf_ig.registration import channels_from_mr
from dvf_ig.session import Heart, model_phase_at, register_gated_volumes

RR_S = 0.6


def peaks(*times: float) -> tuple[RPeak, ...]:
    return tuple(RPeak(t, t + 0.1, 1.0) for t in times)


REGULAR = peaks(*(10.0 + RR_S * np.arange(12)))


@pytest.mark.parametrize("phi", [0.0, 0.2, 0.47, 0.6])
def test_a_time_is_placed_between_its_r_peaks_and_retimed_to_the_models_rate(phi: float) -> None:
    model = ball_model()
    expected = retime(phi, RR_S, model.timing.rr_s, model.es_fraction, mode="two-segment")
    found = model_phase_at(model, REGULAR, 10.0 + RR_S * (4 + phi))
    assert found == pytest.approx(float(expected), abs=1e-9)
    assert abs(found - phi) > 0.003 or phi == 0.0, "the model beats at another rate"


def test_at_the_models_own_rate_the_place_is_the_share_of_rr() -> None:
    model = ball_model()
    own = peaks(*(model.timing.rr_s * np.arange(12)))
    assert model_phase_at(model, own, model.timing.rr_s * 5.35) == pytest.approx(0.35, abs=1e-9)


@pytest.mark.parametrize("t_s", [9.9, 10.0 + 11 * RR_S + 0.01, -5.0])
def test_a_time_outside_the_ecg_is_refused(t_s: float) -> None:
    with pytest.raises(InvalidInputError, match=r"no heart beat of the ECG \(R peaks: 10\.00 to 16\.60 s\)"):
        model_phase_at(ball_model(), REGULAR, t_s)


def test_an_ecg_without_beats_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="R peaks: none"):
        model_phase_at(ball_model(), (), 1.0)


def test_a_time_in_or_after_an_early_beat_is_refused() -> None:
    times = 10.0 + RR_S * np.arange(12)
    times[5] -= 0.25
    for t_s in (times[4] + 0.1, times[5] + 0.3):
        with pytest.raises(InvalidInputError, match="irregular beat"):
            model_phase_at(ball_model(), peaks(*times), t_s)
    model_phase_at(ball_model(), peaks(*times), times[2] + 0.1)


def toy_cine() -> VolumeSeries:
    """Five phases, each a little brighter, so that channels tell them apart."""
    mr = toy_mr()
    values = np.stack([mr.values[0] * (1 + 0.1 * i) for i in range(5)])
    return VolumeSeries(mr.grid, values, CycleTiming(np.array([0.0, 0.2, 0.4, 0.6, 0.8]), 0.8))


def toy_beating_heart() -> Heart:
    channels = channels_from_mr(toy_cine(), smoothing_mm=2.5)
    return Heart(ball_model(), channels, CENTER_MM, None, True)


def at(phase: float, seed: int = 1) -> TrackedVolume:
    return replace(toy_volume((0.5, 0.2, -0.4), seed), model_phase=phase)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """Registrations end where they began; what they were asked."""
    calls: list[SimpleNamespace] = []

    def register(images: Any, heart: Any, start: Rigid, **options: Any) -> Any:
        calls.append(SimpleNamespace(images=images, heart=heart, start=start, **options))
        return replace(any_result(), target_from_source=start, stop=Stop.CONVERGED)

    monkeypatch.setattr("dvf_ig.session.ultrasound_registration.register", register)
    return calls


def clock() -> float:
    return 0.0


def test_volumes_meet_mr_of_the_phases_in_use_smoothed_for_volumes(asked: list[SimpleNamespace]) -> None:
    volumes = [at(0.61), at(0.99), at(0.59)]
    register_gated_volumes(volumes, toy_beating_heart(), toy_pose(), mr=toy_cine(), seed=7, clock=clock)
    (call,) = asked
    expected = channels_from_mr(toy_cine(), smoothing_mm=3.0, phases=[0, 3])
    np.testing.assert_array_equal(call.heart.channels.values, expected.values)
    np.testing.assert_array_equal(call.heart.channels.fractions, [0.0, 0.6])
    assert call.images.options.kind == "volumes"
    assert call.rng.integers(1 << 30) == np.random.default_rng(7).integers(1 << 30)


def test_without_mr_they_meet_the_models_own_channels(asked: list[SimpleNamespace]) -> None:
    heart = toy_beating_heart()
    register_gated_volumes([at(0.4)], heart, toy_pose(), mr=None, seed=0, clock=clock)
    assert asked[0].heart is heart
    assert asked[0].images.options.kind is None


def test_a_phase_that_the_model_lacks_is_told(
    asked: list[SimpleNamespace], caplog: pytest.LogCaptureFixture
) -> None:
    volumes = [at(0.985), at(0.43), at(0.61)]
    with caplog.at_level(logging.WARNING):
        register_gated_volumes(volumes, toy_beating_heart(), toy_pose(), mr=None, seed=0, clock=clock)
    (record,) = caplog.records
    assert record.getMessage() == (
        "an ultrasound volume at 0.430 of the model's cycle is compared with its phase at 0.400, 3.0 % of "
        "the cycle away"
    )


def test_volumes_that_miss_the_model_at_the_start_are_refused(asked: list[SimpleNamespace]) -> None:
    heart = toy_beating_heart()
    away = toy_pose().perturbed_left(np.zeros(3), np.array([300.0, 0.0, 0.0]), CENTER_MM)
    with pytest.raises(NoOverlapError, match="no ultrasound volume reaches the model"):
        register_gated_volumes([at(0.4)], heart, away, mr=None, seed=0, clock=clock)
    assert not asked
    near = toy_pose().perturbed_left(np.zeros(3), np.array([100.0, 0.0, 0.0]), CENTER_MM)
    register_gated_volumes([at(0.4)], heart, near, mr=None, seed=0, clock=clock)
