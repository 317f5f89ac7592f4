"""The experiments of the registration protocol: labels, starts and trial numbers."""

from collections import Counter

import numpy as np

from dvf_ig.study.registration.experiments import (
    BIN_MM,
    CAPTURE,
    EXPERIMENTS,
    FAILURES,
    FAR_MM,
    MOTIONS,
    CaptureOptions,
    settings_of,
    trial_numbers,
)


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
