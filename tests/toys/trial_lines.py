"""Lines of registration trials whose numbers are known by hand."""

from typing import Any


def line(seed: int, start_mm: float | None, tre_mm: float | None, **other: Any) -> dict[str, Any]:
    """One trial; `other` replaces fields."""
    return {
        "seed": seed,
        "pair": seed % 2,
        "motion": "calm",
        "quality": "standard",
        "arm": "B",
        "method": "dvf_ig",
        "condition": "",
        "start_mm": start_mm,
        "tre_mm": tre_mm,
        "rotation_deg": None if tre_mm is None else 2 * tre_mm,
        "translation_mm": None if tre_mm is None else [-tre_mm, tre_mm / 2, 0.0],
        "stop": "converged",
        "usable": True,
        "success_probability": 0.9,
        "seconds": 0.5,
        **other,
    }


TEN = [
    line(0, 1.0, 0.5),
    line(1, 2.0, 0.8),
    line(2, 3.0, 1.0),
    line(3, 3.5, 1.5),
    line(4, 5.0, 2.0),
    line(5, 6.0, 3.0),
    line(6, 9.0, 10.0, usable=False, success_probability=0.1),
    line(7, 11.0, None, stop="poor match", success_probability=0.9, seconds=1.5),
    line(8, 11.5, 1.9, usable=False, success_probability=0.3),
    {**line(9, 12.0, None), "refused": "no overlap", "tre_mm": None, "usable": None},
]
