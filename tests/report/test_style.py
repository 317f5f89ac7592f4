"""One look: the same figure gives the same bytes, and only PNG files are written as PNG."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from dvf_ig.core import InvalidInputError
from dvf_ig.report.style import ESTIMATE, START, TRUTH, png_bytes, svg_bytes, write_png


def drawn() -> Figure:
    figure = Figure(figsize=(2.0, 1.0))
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color=ESTIMATE)
    axis.fill_between([0, 1], [0, 1], color=START)
    return figure


def test_the_same_figure_gives_the_same_bytes() -> None:
    assert png_bytes(drawn()) == png_bytes(drawn())
    assert svg_bytes(drawn()) == svg_bytes(drawn())
    assert svg_bytes(drawn()).startswith(b"<?xml")


def test_pictures_are_png(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", drawn())
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InvalidInputError, match=r"does not end in \.png"):
        write_png(tmp_path / "a.jpg", drawn())
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_estimate_start_and_truth_differ() -> None:
    assert len({ESTIMATE, START, TRUTH}) == 3
