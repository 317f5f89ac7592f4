"""What a line of `trials.jsonl` says of one registration: its error, and whether that is a success.

A line has `seed pair motion quality arm method condition start_mm tre_mm rotation_deg translation_mm stop
usable success_probability seconds`; a refused one only what was known of it. `arm` is the letter of the
experiment, `tre_mm` the mean target registration error of one run, `start_mm` that of its start.
"""

import math

from dvf_ig.study.trials import Line

STRICT_MM, SUCCESS_MM, FAILURE_MM = 1.0, 2.0, 3.0
"""A run below the second is a success, below the first a strict one, above the third a failure."""


def number(line: Line, name: str) -> float:
    """The line's value as a number; NaN where it has none."""
    value = line.get(name)
    return math.nan if value is None else float(value)


def error_of(line: Line) -> float:
    """Target registration error, mm: infinite where a run ended without a finite one, NaN where refused."""
    if "refused" in line:
        return math.nan
    error = number(line, "tre_mm")
    return error if math.isfinite(error) else math.inf
