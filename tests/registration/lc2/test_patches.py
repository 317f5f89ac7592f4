"""Each place counts alike, however many slices show it."""

import numpy as np
import pytest
from toy_heart import toy_mr, toy_pose, toy_slices

from dvf_ig.registration import Lc2, SliceSet, channels_from_mr
from dvf_ig.registration.lc2.patches import (
    LEAST_DENSITY,
    inverse_density_weights,
    patch_centers_mm,
    patches_of,
    pixel_runs,
)


def seen(place_mm: list[float], times: int) -> np.ndarray:
    return np.tile(np.array(place_mm), (times, 1))


def test_places_weigh_alike_though_one_was_seen_more_often() -> None:
    weights = inverse_density_weights(
        np.vstack([seen([0, 90, 0], 20), seen([90, 0, 40], 40), seen([0, 0, 0], 40)]), 12.0
    )
    np.testing.assert_allclose(weights[:20].sum(), weights[20:60].sum())
    np.testing.assert_allclose(weights[20:60].sum(), weights[60:].sum())


def test_a_lone_patch_counts_for_no_more_than_the_bound() -> None:
    weights = inverse_density_weights(np.vstack([seen([0, 0, 0], 50), seen([80, 10, 5], 1)]), 12.0)
    np.testing.assert_allclose(weights[:50], 1.0)
    assert weights[50] == pytest.approx(1 / LEAST_DENSITY)
    assert len(inverse_density_weights(np.zeros((0, 3)), 12.0)) == 0


def test_weights_do_not_depend_on_the_order() -> None:
    rng = np.random.default_rng(0)
    places, order = rng.normal(scale=20.0, size=(300, 3)), rng.permutation(300)
    np.testing.assert_allclose(
        inverse_density_weights(places[order], 12.0), inverse_density_weights(places, 12.0)[order]
    )


def test_patch_centres_lie_where_the_slices_put_them() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=4.0, speckle=0.1)
    patches = patches_of(slices, pixel_runs(slices), 2)
    places = patch_centers_mm(slices, patches.first, patches.centers)
    s = 3
    row, column = patches.centers[patches.first[s]]
    np.testing.assert_allclose(
        places[patches.first[s]], slices.frame_from_pixel[s] @ np.array([column, row, 1.0])
    )


def test_repeated_slices_do_not_outvote_the_others() -> None:
    """Slices given five times over pull no harder than once where weight is shared, and harder where not."""
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(1), pitch_mm=4.0, speckle=0.3)
    again = slices.subset(np.array([*range(len(slices)), *[0, 1] * 4]))
    model = channels_from_mr(toy_mr(), smoothing_mm=2.0)

    def share(metric: Lc2) -> float:
        weight = metric.per_slice(toy_pose())[:, 1]
        return float((weight[[0, 1]].sum() + weight[len(slices) :].sum()) / weight.sum())

    def of(which: SliceSet, density_width_mm: float | None) -> float:
        return share(Lc2(which, model, patch_mm=13.0, pitch_mm=4.0, density_width_mm=density_width_mm))

    growth_unweighted = of(again, None) / of(slices, None)
    growth_weighted = of(again, 12.0) / of(slices, 12.0)
    assert growth_unweighted > 2.0
    assert 1.0 <= growth_weighted < 0.75 * growth_unweighted
