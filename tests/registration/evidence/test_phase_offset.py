"""A common error of the slices' phases is found from the images of a beating heart, and none without it."""

import numpy as np
import pytest
from scipy import ndimage
from toy_heart import toy_mr, toy_pose, toy_slices

from dvf_ig.core import CycleTiming, VolumeSeries
from dvf_ig.registration import Lc2, SliceSet, channels_from_mr, phase_offset
from dvf_ig.registration.evidence.phase_offset import offset_of
from dvf_ig.registration.lc2.slices import joined

PHASES = 10
RR_S = 0.8


def beating_mr() -> VolumeSeries:
    """The toy heart, smaller by up to 24 % about its centre, with a quick systole and a slow diastole."""
    still = toy_mr()
    center = (np.array(still.values.shape[1:]) - 1) / 2
    volumes = []
    for phase in np.arange(PHASES) / PHASES:
        scale = 1.0 / (1.0 - 0.24 * np.sin(np.pi * phase**0.6) ** 2)
        step = np.full(3, scale)
        volumes.append(
            ndimage.affine_transform(still.values[0], step, center - scale * center, order=1, mode="nearest")
        )
    return VolumeSeries(still.grid, np.stack(volumes), CycleTiming.uniform(PHASES, RR_S))


MR = beating_mr()
MODEL = channels_from_mr(MR, smoothing_mm=2.0)


def slices_late_by(shift: float) -> SliceSet:
    """Slices of every phase that claim to belong `shift` of a cycle earlier than they do."""
    sets = []
    for k, phase in enumerate(MR.timing.fractions):
        one = VolumeSeries(MR.grid, MR.values[[k, k]], CycleTiming.uniform(2, RR_S))
        taken = toy_slices(one, toy_pose(), np.random.default_rng(k), pitch_mm=4.0, speckle=0.3)
        taken.model_phase.setflags(write=True)
        taken.model_phase[:] = (phase - shift) % 1.0
        sets.append(taken.subset(np.arange(k % 2, 12, 2)))
    return joined(sets)


@pytest.mark.parametrize("shift", [0.3, -0.2])
def test_a_clock_that_is_off_is_found_with_its_sign_and_size(shift: float) -> None:
    metric = Lc2(slices_late_by(shift), MODEL, patch_mm=13.0, pitch_mm=4.0)
    found = phase_offset(metric, toy_pose(), RR_S)
    assert found.offset_s == pytest.approx(shift * RR_S, abs=0.5 * RR_S / PHASES)
    assert found.suspicious
    assert ("late" if shift > 0 else "early") in found.sentence


def test_a_clock_that_is_right_raises_no_suspicion() -> None:
    metric = Lc2(slices_late_by(0.0), MODEL, patch_mm=13.0, pitch_mm=4.0)
    found = phase_offset(metric, toy_pose(), RR_S)
    assert abs(found.offset_s) < 0.5 * RR_S / PHASES
    assert not found.suspicious


def test_the_optimum_of_a_parabola_is_met_between_its_samples() -> None:
    shifts = (np.arange(20) / 20 + 0.5) % 1.0 - 0.5
    found = offset_of(3.0 - 40.0 * (shifts - 0.13) ** 2, 1.0)
    assert found.shift == pytest.approx(0.13)
    assert found.log_likelihood_ratio == pytest.approx(3.0)


def test_sentence_names_the_size_in_ms() -> None:
    shifts = (np.arange(20) / 20 + 0.5) % 1.0 - 0.5
    assert "300 ms late" in offset_of(9.0 - 90.0 * (shifts - 0.3) ** 2, 1.0).sentence
