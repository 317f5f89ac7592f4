"""The phantom's MR as an examination: where slices lie, their breath-holds, and the truth of both."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from data_synth import Examination, ScenarioSpec, examination
from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.mr import examination as module
from data_synth.mr.examination import BELOW_BASE_MM, EXAMS, RR_JITTER, SHIFT_MM, SLICES
from dvf_ig.core import InvalidInputError


@pytest.fixture(scope="module")
def coarse(anatomy: PhantomAnatomy) -> Examination:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PIXEL_MM", 5.0)
        patch.setattr(module, "PHASES", (3, 3))
        return examination(anatomy, anatomy.reference, "sax+lax", np.random.default_rng(4))


def test_slices_run_from_the_apex_to_the_mitral_plane(anatomy: PhantomAnatomy, coarse: Examination) -> None:
    apex, base = anatomy.long_axis_mm
    axis = (base - apex) / np.linalg.norm(base - apex)
    grid = coarse.sax.image.grid
    np.testing.assert_allclose(grid.direction[:, 2], axis, atol=1e-9)
    assert SLICES[0] <= grid.shape[2] <= SLICES[1]
    heights = [(grid.to_mm(np.array([0.0, 0.0, k])) - apex) @ axis for k in range(grid.shape[2])]
    assert heights[-1] == pytest.approx(np.linalg.norm(base - apex) - BELOW_BASE_MM)
    assert np.diff(heights) == pytest.approx(10.0)
    assert (coarse.sax.labels.values[0][..., 1:] > 0).any(axis=(0, 1)).all(), "every slice but the first"


def test_seven_slices_leave_apex_and_base_out(
    anatomy: PhantomAnatomy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PIXEL_MM", 5.0)
    grid = examination(anatomy, anatomy.reference, "sax7", np.random.default_rng(4), 3).sax.image.grid
    apex, base = anatomy.long_axis_mm
    axis, length = (base - apex) / np.linalg.norm(base - apex), np.linalg.norm(base - apex)
    assert grid.shape[2] == 7
    ends = np.array([(grid.to_mm(np.array([0.0, 0.0, k])) - apex) @ axis for k in (0, 6)])
    np.testing.assert_allclose(ends, [0.5 * length - 30.0, 0.5 * length + 30.0])


def test_views_hold_the_long_axis_and_stand_across_the_stack(
    anatomy: PhantomAnatomy, coarse: Examination
) -> None:
    assert len(coarse.views) == 3
    for view in coarse.views:
        assert view.grid.shape[2] == 1
        assert abs(view.grid.direction[:, 2] @ coarse.sax.image.grid.direction[:, 2]) < 1e-9
        index = view.grid.to_index(anatomy.long_axis_mm)
        np.testing.assert_allclose(index[:, 2], 0.0, atol=1e-6)
        assert (index[:, :2] > 0).all()
        assert (index[:, :2] < np.array(view.grid.shape[:2])).all()


def test_breath_holds_differ_and_are_told(anatomy: PhantomAnatomy, coarse: Examination) -> None:
    truth: Any = coarse.truth()
    every = [truth["sax"], *truth["lax"].values()]
    shifts = np.vstack([np.array(one["shift_mm"]) for one in every])
    assert 0.5 < np.linalg.norm(shifts, axis=1).max() <= SHIFT_MM
    rr_s = np.concatenate([one["rr_s"] for one in every])
    assert 0.02 < np.abs(rr_s / anatomy.rr_s - 1).max() <= RR_JITTER
    assert len(coarse.base_mm) == 3
    moved = anatomy.deformed(anatomy.long_axis_mm[1:], 1 / 3) - anatomy.long_axis_mm[1:]
    assert coarse.base_mm[1] == pytest.approx(-float((moved @ coarse.sax.image.grid.direction[:, 2])[0]))


def test_only_end_diastole_is_labelled(coarse: Examination) -> None:
    preop = coarse.preop("someone")
    assert preop.labels is None
    assert preop.ed_labels is not None
    np.testing.assert_array_equal(preop.ed_labels.values, coarse.sax.labels.values[0])
    assert preop.views == coarse.views


def test_an_unknown_examination_is_refused() -> None:
    unknown: Any = "sax12"
    with pytest.raises(InvalidInputError, match="sax12"):
        replace(ScenarioSpec(), exam=unknown)
    assert EXAMS == ("sax7", "sax8", "sax10", "sax+lax")
