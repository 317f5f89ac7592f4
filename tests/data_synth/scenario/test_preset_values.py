"""What presets state: rates, names, sentences about their faults, and what is refused."""

import numpy as np
import pytest

from data_synth import PRESETS, Preset, ScenarioSpec, describe_faults, preset_name
from data_synth.breathing.breaths import BreathSpec
from data_synth.scenario.displacement import Displacement
from data_synth.signals.ecg import EcgSpec
from data_synth.signals.occlusion import OcclusionSpec
from data_synth.signals.rhythm import beat_series
from dvf_ig.core import InvalidInputError


def test_rates_and_early_beats() -> None:
    ramp = beat_series(PRESETS["tachycardia"].rhythm, -3.0, 63.0, np.random.default_rng(2)).r_peaks_s
    rate = 60.0 / np.diff(ramp)
    # a few beats at each end, which vary by some 2 %
    assert rate[ramp[:-1] < 8.0].mean() == pytest.approx(60.0, rel=0.03)
    assert rate[ramp[:-1] > 52.0].mean() == pytest.approx(120.0, rel=0.03)
    beats = beat_series(PRESETS["ectopy"].rhythm, 0.0, 1200.0, np.random.default_rng(2))
    early = np.flatnonzero(beats.ectopic[1:-1])
    rr = np.diff(beats.r_peaks_s) / (60.0 / 72.0)
    # no two in a row: a share p of the beats that may be early makes p/(1 + p) of all
    assert len(early) / len(rr) == pytest.approx(0.1 / 1.1, rel=0.3)
    np.testing.assert_allclose(rr[early] + rr[early + 1], 2.0, atol=0.2)


def test_image_presets_show_what_they_are_called() -> None:
    for shows in ("noise", "black", "frozen"):
        failure = PRESETS[f"{shows}-ultrasound"].image_failure
        assert (failure.shows, failure.at_share) == (shows, 0.5)


@pytest.mark.parametrize(
    "spelling", ["line-of-sight loss", "Line of sight loss", "line_of_sight_loss", "line-of-sight-loss"]
)
def test_presets_may_be_spelt_with_spaces(spelling: str) -> None:
    assert preset_name(spelling) == "line-of-sight-loss"
    assert ScenarioSpec(spelling).preset == "line-of-sight-loss"


def test_faults_are_told_without_their_size() -> None:
    assert describe_faults(PRESETS["calm"]) == ()
    for name, preset in PRESETS.items():
        told = describe_faults(preset)
        assert bool(told) is (name != "calm")
        assert not any(character.isdigit() for sentence in told for character in sentence)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (Displacement, {"at_share": 1.5}),
        (Displacement, {"shift_mm": -1.0}),
        (Displacement, {"shift_up_to_mm": 101.0}),
        (Displacement, {"wait_s": (3.0, 2.0)}),
        (EcgSpec, {"latency_s": -0.1}),
        (OcclusionSpec, {"losses_per_min": -1.0}),
        (OcclusionSpec, {"loss_s": (3.0, 2.0)}),
        (Preset, {"other_probe_mm": -1.0}),
        (Preset, {"video_drift_ppm": 1e5}),
        (BreathSpec, {"excursion_mm": 99.0}),
        (Preset, {"mismatch_mm": 9.0}),
        (Preset, {"contraction": (1.0, 2.0)}),
        (Preset, {"still_mm": 10.0}),
        (Preset, {"start_mm": -1.0}),
    ],
)
def test_impossible_faults_are_refused(kind: type, changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError):
        kind(**changes)
