"""The page of all constants: value, purpose, the hearts they were chosen on, and what ± 30 % do."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.study.trials import Line

from .listing import Constant, Number
from .subjects import subject_of
from .trial import FACTORS

NOT_TRIED = "not tried"
MOST_VALUES = 6
"""Of a longer tuple the smallest and the largest are given."""
COLUMNS = ("constant", "value", "what it does", "chosen on", "tried on", "× 0.7", "× 1.3")


INTRODUCTION = """# Constants of registration

Every number by which registration, its evidence and the session's use of both decide, as
`dvf-ig study constants --hearts {hearts} -o DIR` lists them: value, what it does, and the seeds, hearts or
patients that the code says it was chosen on. Each was also made 30 % smaller and larger (whole numbers by
one at least), with all others as they are, and {hearts} tuning hearts, or brains, were registered from 8 mm
off: hearts with calm and with poor images, brains with T1 and with FLAIR. The last columns say how the mean
error changes, the largest error, and how many more poses are refused; `none`: no pose changes in any digit.
They are empty for constants that act in none of these, and say `not tried` of any that a run did not come
to. So few hearts tell which constants matter, not which value is the best.

| tried on | registrations | mean error as it is | largest | refused |
|---|---|---|---|---|
"""


def constants_page(constants: Sequence[Constant], lines: Sequence[Line], hearts: int) -> str:
    """The whole page: what was done, errors with all constants as they are, and a table for each module."""
    as_it_is = [_unchanged_row(line) for line in lines if not line["constant"]]
    tables = [
        f"\n## {place}\n\n{table_markdown(list(there), lines)}"
        for place, there in groupby(constants, key=lambda constant: constant.place)
    ]
    return INTRODUCTION.format(hearts=hearts) + "".join(as_it_is) + "".join(tables)


def _unchanged_row(line: Line) -> str:
    errors = _errors(line)
    reached = errors[np.isfinite(errors)]
    sizes = [f"{reached.mean():.2f} mm", f"{reached.max():.1f} mm"] if len(reached) else ["", ""]
    return _joined([line["subject"], str(len(errors)), *sizes, str(line["refused_n"])])


def table_markdown(constants: Sequence[Constant], lines: Sequence[Line]) -> str:
    """One row a constant; the last columns stay empty for one that acts in no subject, and say so of one that
    `lines` do not hold.

    A change is given as that of the mean error over the cases that gave a pose both ways, the largest error,
    and how many more poses were refused.
    """
    found = {(line["constant"], line["factor"]): line for line in lines if line["constant"]}
    unchanged = {line["subject"]: line for line in lines if not line["constant"]}
    head = _joined(COLUMNS) + _joined(["---"] * len(COLUMNS))
    return head + "".join(_row(constant, found, unchanged) for constant in constants)


def _row(constant: Constant, found: dict[tuple[str, float], Line], unchanged: dict[str, Line]) -> str:
    subject = subject_of(constant)
    cells = [
        f"`{constant.in_module}`",
        value_text(constant.value),
        _cell(_begun_as_sentence(constant.purpose)),
        _cell(constant.chosen_on),
    ]
    if subject is None:
        return _joined([*cells, "", *("" for _ in FACTORS)])
    changes = [
        _change(found[constant.label, factor], unchanged[subject])
        if (constant.label, factor) in found
        else NOT_TRIED
        for factor in FACTORS
    ]
    return _joined([*cells, subject.value, *changes])


def value_text(value: Number) -> str:
    """A constant's value as the table shows it."""
    if not isinstance(value, tuple):
        return f"{value:g}"
    if len(value) > MOST_VALUES:
        return f"{len(value)} from {min(value):g} to {max(value):g}"
    return ", ".join(map(value_text, value))


def _joined(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |\n"


def _begun_as_sentence(text: str) -> str:
    """With a capital, unless it begins with a symbol of one letter."""
    return text[:1].upper() + text[1:] if text[1:2].isalpha() else text


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _change(line: Line, unchanged: Line) -> str:
    before, after = _errors(unchanged), _errors(line)
    more = line["refused_n"] - unchanged["refused_n"]
    if np.array_equal(before, after, equal_nan=True) and more == 0:
        return "none"
    both = np.isfinite(before) & np.isfinite(after)
    if not both.any():
        return f"no pose; {more:+d} refused"
    change = f"{(after - before)[both].mean():+z.2f} mm, max {after[both].max():.1f}".replace("-", "−")
    return change if more == 0 else f"{change}; {more:+d} refused"


def _errors(line: Line) -> FloatArray:
    return np.array([np.nan if x is None else x for x in line["tre_mm"]], dtype=np.float64)
