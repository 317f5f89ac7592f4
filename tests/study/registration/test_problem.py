"""Registration problems: the same image is found again; retiming has no error at the model's own rate."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stub_registration import TARGETS
from toy_heart import CENTER_MM, toy_mr, toy_pose

import dvf_ig.study.registration.problem as problems
import dvf_ig.study.registration.trial as trials
from dvf_ig.core import VolumeSeries
from dvf_ig.study.registration.experiments import (
    SAME_IMAGE,
    settings_of,
)
from dvf_ig.study.registration.problem import GATED
from dvf_ig.study.registration.trial import registration_trial


def toy_pair(spec: Any) -> SimpleNamespace:
    mr = toy_mr()
    codes = 1 + (mr.values > mr.values.mean()).astype(np.uint8)
    preop = SimpleNamespace(
        mr=mr,
        labels=VolumeSeries(mr.grid, codes, mr.timing),
        label_names=((1, "wall"), (2, "blood")),
        organ_labels=(1, 2),
        blood_labels=(2,),
    )
    points = SimpleNamespace(points=TARGETS)
    return SimpleNamespace(
        spec=spec, preop=preop, targets=points, center_mm=CENTER_MM, mr_from_tracker=toy_pose()
    )


@pytest.mark.parametrize("number", [0, 5])
def test_the_same_image_is_found_to_a_fortieth_of_a_millimetre(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Same image on the toy heart: what the way through tracker, planes, search and blocks costs."""
    monkeypatch.setattr(problems, "image_pair", toy_pair)
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()
    line = registration_trial(settings_of(SAME_IMAGE), number)
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()
    assert line["start_mm"] > 2.0
    assert line["tre_mm"] < 0.025
    assert line["rotation_deg"] < 0.1


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
