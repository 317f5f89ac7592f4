"""Blending errors shrink with the number of phases, down to what the splines themselves leave."""

import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance.blend import BLEND_CODES
from dvf_ig.study.blending.blend_errors import blending_errors


@pytest.fixture(scope="module")
def study():
    return blending_errors("physiological", [4, 10], knot_spacing_mm=7.0, threads=2, seeds=[101])


def test_more_phases_err_less(study):
    assert {(e.blend, e.phases) for e in study.errors} == {(b, n) for b in BLEND_CODES for n in (4, 10)}
    for blend in BLEND_CODES:
        few, many = (e for e in study.errors if e.blend == blend)
        assert many.blend_mean_mm < 0.5 * few.blend_mean_mm
        assert many.surface_mean_mm < few.surface_mean_mm
        assert many.force_mean_n < few.force_mean_n
        assert many.surface_mean_mm <= many.surface_p95_mm <= many.surface_max_mm
    assert study.largest_motion_mm == pytest.approx(14.0, abs=1.5)


def test_at_the_phases_only_the_fit_errs(study):
    at = study.at_phases
    assert at.phases == 10
    assert at.blend_mean_mm is None
    for error in study.errors:
        assert error.surface_mean_mm > at.surface_mean_mm


@pytest.mark.parametrize("counts", [[], [3, 10]])
def test_counts_are_checked(counts):
    with pytest.raises(InvalidInputError, match="numbers of phases"):
        blending_errors("paper5mm", counts, seeds=[1])
