"""The table of all constants: value, purpose, the hearts they were chosen on, and what ± 30 % do."""

from collections.abc import Sequence

import numpy as np

from dvf_ig.study.trials import Line

from .listing import Constant
from .trial import FACTORS

HEAD = "| constant | value | what it does | chosen on | × 0.7 | × 1.3 |\n|---|---|---|---|---|---|\n"


def table_markdown(constants: Sequence[Constant], lines: Sequence[Line]) -> str:
    """One row a constant; without trials the last two columns are empty.

    A change is given as that of the median error over the hearts, and of how many poses were refused.
    """
    found = {(line["constant"], line["factor"]): line for line in lines if "refused" not in line}
    unchanged = found.get(("", 1.0))
    rows = [
        "| "
        + " | ".join(
            (
                f"`{constant.label}`",
                f"{constant.value:g}",
                _cell(constant.purpose),
                _cell(constant.chosen_on),
                *(_change(found.get((constant.label, factor)), unchanged) for factor in FACTORS),
            )
        )
        + " |"
        for constant in constants
    ]
    return HEAD + "\n".join(rows) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _change(line: Line | None, unchanged: Line | None) -> str:
    if line is None or unchanged is None:
        return ""
    before, after = _errors(unchanged), _errors(line)
    if np.array_equal(before, after, equal_nan=True) and line["refused_n"] == unchanged["refused_n"]:
        return "none"
    change = f"{np.nanmedian(after) - np.nanmedian(before):+.2f} mm, max {np.nanmax(after):.1f}"
    more = line["refused_n"] - unchanged["refused_n"]
    return change if more == 0 else f"{change}; {more:+d} refused"


def _errors(line: Line) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.array([np.nan if x is None else x for x in line["tre_mm"]], dtype=np.float64)
