"""What runs on pairs say together: shares over pairs, with another patient's MR always bad."""

from typing import Any

from dvf_ig.study.pairs import summarise_pairs


def run(error_mm: float | None, *, usable: bool, start_mm: float = 4.0) -> dict[str, Any]:
    return {
        "patient": "another patient" if error_mm is None else "own",
        "contrasts": "t1",
        "start_mm": 0.0 if error_mm is None else start_mm,
        "error_mm": error_mm,
        "usable": usable,
        "cpu_seconds": 2.0,
    }


def test_shares_are_over_pairs() -> None:
    lines = [
        {"seed": 1, "runs": [run(1.0, usable=True), run(None, usable=False)]},
        {"seed": 2, "runs": [run(1.2, usable=False), run(None, usable=True)]},
        {"seed": 3, "runs": [run(7.0, usable=False), run(None, usable=False)]},
        {"seed": 4, "runs": [run(2.5, usable=True), run(None, usable=False)]},
        {"seed": 5, "refused": "no overlap"},
    ]
    own, other = summarise_pairs(lines)
    assert (own.success.count, own.success.of) == (2, 4)
    assert (own.good_refused.count, own.good_refused.of) == (1, 2)
    assert (own.bad_refused.count, own.bad_refused.of) == (1, 1)  # 2.5 mm is neither
    assert other.success.of == other.good_refused.of == 0
    assert (other.bad_refused.count, other.bad_refused.of) == (3, 4)
    assert other.error_median_mm is None
