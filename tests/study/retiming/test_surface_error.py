"""The retiming study: exact where the method assumes the heart's own law, wrong where it does not."""

from dvf_ig.study.retiming.surface_error import compare_retiming


def test_two_segment_follows_the_law_and_uniform_does_not() -> None:
    found = compare_retiming([110.0], true_slopes_s_per_bpm=[0.002, 0.0013])
    rows, wrong = ({r.method: r for r in found[part : part + 3]} for part in (0, 3))
    # the same law, written twice: only the tabulated surface lies between
    assert rows["two-segment"].max_mm < 1e-6
    assert rows["uniform"].p95_mm > 1.0
    assert rows["not retimed"].p95_mm > rows["uniform"].p95_mm
    assert wrong["two-segment"].p95_mm > 0.5, "a wrong k costs"
    assert wrong["two-segment"].p95_mm < wrong["uniform"].p95_mm


def test_errors_of_several_hearts_are_pooled() -> None:
    single = [compare_retiming([110.0], true_slopes_s_per_bpm=[0.0013], seeds=[seed]) for seed in (1, 2)]
    both = compare_retiming([110.0], true_slopes_s_per_bpm=[0.0013], seeds=[1, 2])
    for pooled, one, other in zip(both, *single, strict=True):
        assert sorted((one.mean_mm, pooled.mean_mm, other.mean_mm))[1] == pooled.mean_mm
        assert pooled.max_mm == max(one.max_mm, other.max_mm)
