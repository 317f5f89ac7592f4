"""A hardware trigger as the source of beats."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.cardiac import trigger_peaks
from dvf_ig.core import InvalidInputError
from dvf_ig.io import read_triggers


def test_r_lies_before_the_pulse_that_makes_it_known() -> None:
    peaks = trigger_peaks(np.array([1.0, 1.8]), 0.03)
    assert [p.t_s for p in peaks] == pytest.approx([0.97, 1.77])
    assert [p.detected_at_s for p in peaks] == [1.0, 1.8]


@pytest.mark.parametrize(
    ("times", "delay_s", "message"),
    [
        ([], 0.0, "at least 1"),
        ([1.0, np.nan], 0.0, "not finite"),
        ([1.0, 0.5], 0.0, "order the pulses"),
        ([1.0, 1.1], 0.0, "at least 0.2 s"),
        ([1.0, 2.0], 20.0, "is it in ms"),
        ([1.0, 2.0], -0.1, "needed 0 to"),
    ],
)
def test_refusals(times: list[float], delay_s: float, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        trigger_peaks(np.array(times), delay_s)


def test_file_with_and_without_header(tmp_path: Path) -> None:
    path = tmp_path / "pulses.csv"
    path.write_text("0.5\n1.25\n\n2.0\n")
    assert read_triggers(path).tolist() == [0.5, 1.25, 2.0]
    path.write_text("time s\n0.5,\n")
    assert read_triggers(path).tolist() == [0.5]


@pytest.mark.parametrize(
    ("text", "message"), [("", "no trigger"), ("t\n", "no trigger"), ("1\nx\n", "line 2")]
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "pulses.csv"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=message):
        read_triggers(path)
