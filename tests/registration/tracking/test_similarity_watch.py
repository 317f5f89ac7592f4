"""A lasting fall of the similarity is told from that of another view, and is not learnt as normal."""

import numpy as np

from dvf_ig.registration import SimilarityWatch

FAR_MM = np.full((3, 3), 30.0)
SCATTER = 0.02


def alarm_after(
    seed: int, beats: int, *, onset: int, drop_per_beat: float = 0.0, drop: float = 0.0
) -> int | None:
    """Beats from `onset` on until the alarm; two views 30 mm apart take turns every five beats."""
    watch, rng = SimilarityWatch.new(), np.random.default_rng(seed)
    for k in range(beats):
        other = k // 5 % 2
        lower = (drop + drop_per_beat * (k - onset)) * (k >= onset)
        similarity = 0.55 - 0.1 * other - lower + SCATTER * rng.normal()
        watch = watch.after(0.8 * k, other * FAR_MM, similarity)
        if watch.alarm:
            return k - onset
    return None


def test_views_that_match_differently_are_no_change() -> None:
    assert all(alarm_after(seed, 400, onset=400) is None for seed in range(5))


def test_a_fall_that_stays_is_found_within_some_beats() -> None:
    found = [alarm_after(seed, 70, onset=50, drop=0.1) for seed in range(10)]
    assert all(beats is not None and 0 < beats < 8 for beats in found)


def test_a_slow_fall_is_not_learnt_as_normal() -> None:
    found = [alarm_after(seed, 120, onset=40, drop_per_beat=0.003) for seed in range(5)]
    assert all(beats is not None for beats in found)


def test_nothing_is_said_before_a_sweep_has_been_seen() -> None:
    watch = SimilarityWatch.new()
    for k in range(12):
        watch = watch.after(0.8 * k, np.zeros((3, 3)), 0.6 if k < 6 else 0.1)
        assert watch.cusum == 0.0
