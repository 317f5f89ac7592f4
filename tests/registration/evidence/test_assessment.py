"""What is said of a pose's error: monotone in every check, silent outside what was calibrated."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.registration import Evidence, ImageStatistics
from dvf_ig.registration.evidence.assessment import FEATURES, Table, assess, features_of, table_of

STATISTICS = ImageStatistics(0.3, 0.8, 0.8, 0.9, 48.0, 30.0, 25.0, 0.55, 0.9, 300.0)
GOOD = Evidence(z_score=11.0, split_half_mm=0.4, phase_mm=0.6, half_volume_mm=0.6, boundary_mm=1.0)


def table() -> Table:
    count = len(FEATURES)
    return Table(
        hearts=200,
        intercept=0.5,
        weights=np.full(count, 0.2),
        low=np.full(count, -3.0),
        high=np.full(count, 3.0),
        missing=np.full(count, 1.0),
        predicted=np.array([-1.0, 0.0, 1.0]),
        probability=np.array([0.99, 0.9, 0.05]),
        refused_probability=0.1,
        bound_quantile=0.4,
        largest=0.8,
        scale_intercept=0.3,
        scale_weights=np.where(np.array(FEATURES) == "predicted_mm", -1.0, 0.1),
        ranges={name: (0.5 * value, 1.5 * value) for name, value in STATISTICS.values().items()},
        outside_p=0.1,
    )


def features(evidence: Evidence = GOOD, predicted_mm: float = 1.2) -> dict[str, float | None]:
    return features_of(evidence, STATISTICS.similarity, predicted_mm, None)


def test_a_covariance_that_claims_less_than_the_checks_is_widened() -> None:
    modest, bold = (
        assess(table(), features(predicted_mm=size), STATISTICS).covariance_scale for size in (1.2, 0.3)
    )
    assert bold > 2.0 * modest
    assert assess(table(), features(predicted_mm=1e-3), STATISTICS).covariance_scale <= 16.0
    assert assess(None, features(), STATISTICS).covariance_scale == 1.0
    strange = replace(STATISTICS, view_spread_deg=2.0)
    calm = replace(table(), scale_intercept=-2.0, scale_weights=np.zeros(len(FEATURES)))
    assert assess(calm, features(), STATISTICS).covariance_scale < 1.0
    assert assess(calm, features(), strange).covariance_scale == 1.0  # never narrowed by what is not known


@pytest.mark.parametrize("name", ["split_half_mm", "phase_mm", "half_volume_mm", "boundary_mm"])
def test_a_worse_check_never_raises_the_probability_nor_lowers_the_bound(name: str) -> None:
    chances, bounds = [], []
    for value in (0.1, 0.5, 1.0, 3.0, 9.0, math.inf):
        found = assess(table(), features(replace(GOOD, **{name: value})), STATISTICS)
        chances.append(found.success_probability or 0.0)
        bounds.append(found.tre_bound_mm or 0.0)
    assert chances == sorted(chances, reverse=True)
    assert bounds == sorted(bounds)
    assert chances[0] > chances[-1]


def test_a_check_that_could_not_be_made_lowers_the_ceiling() -> None:
    known = assess(table(), features(), STATISTICS)
    unknown = assess(table(), features(replace(GOOD, half_volume_mm=None)), STATISTICS)
    assert known.success_probability is not None
    assert unknown.success_probability is not None
    assert unknown.success_probability < known.success_probability


def test_the_bound_is_the_prediction_times_its_quantile() -> None:
    one = assess(table(), features(), STATISTICS)
    wider = assess(replace(table(), bound_quantile=0.9), features(), STATISTICS)
    assert one.tre_bound_mm is not None
    assert wider.tre_bound_mm == pytest.approx(one.tre_bound_mm * math.exp(0.5))
    assert assess(replace(table(), bound_quantile=math.inf), features(), STATISTICS).tre_bound_mm is None


def test_evidence_worse_than_that_of_good_poses_is_doubtful() -> None:
    assert not assess(table(), features(), STATISTICS).doubtful
    bad = Evidence(z_score=0.5, split_half_mm=9.0, phase_mm=9.0, half_volume_mm=9.0, boundary_mm=9.0)
    assert assess(table(), features(bad, 5.0), STATISTICS).doubtful
    # images unlike those calibrated are judged no more mildly
    strange = replace(STATISTICS, view_spread_deg=2.0)
    assert not assess(table(), features(), strange).doubtful
    assert assess(table(), features(bad, 5.0), strange).doubtful


def test_images_unlike_all_that_was_calibrated_get_a_sentence_instead_of_a_number() -> None:
    flat = assess(table(), features(), replace(STATISTICS, view_spread_deg=2.0))
    assert flat.success_probability is flat.tre_bound_mm is None
    assert flat.outside == (
        "outside what was calibrated: the spread of the views (°) is 2, where calibrated it was 15 to 45"
    )
    none = assess(None, features(), STATISTICS)
    assert none.success_probability is None
    assert "no probability was calibrated" in none.outside


def test_no_kind_has_no_table() -> None:
    assert table_of(None) is None
    assert table_of("brains of whales") is None
