"""Segmented points as CSV: what is read, and what is refused with the line's number."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.core import UnreadableFileError
from dvf_ig.io import read_feature_points

HEAD = "frame,column1_px,row1_px\n"


def test_rows_find_their_frames_and_gaps_are_nan(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(HEAD + "2,10.5,20.25\n0,,\n")
    points = read_feature_points(path, 4)
    assert points.shape == (4, 1, 2)
    assert points[2, 0].tolist() == [10.5, 20.25]
    assert np.isnan(points[[0, 1, 3]]).all()
    assert len(read_feature_points(path)) == 3
    path.write_text("frame,column1_px,row1_px,column2_px,row2_px\n0,1,2,3,4\n")
    assert read_feature_points(path).tolist() == [[[1, 2], [3, 4]]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no rows of numbers"),
        ("x,y\n1,2\n", "columns x, y"),
        (HEAD + "0,1\n", "line 2: 2 cells under 3 names"),
        (HEAD + "0,1,2\n1,one,2\n", "line 3"),
        (HEAD + "1.5,1,2\n", "not a frame number"),
        (HEAD + "0,1,2\n0,1,2\n", "twice"),
        (HEAD + "9,1,2\n", "frame 9, the sequence has 4"),
    ],
)
def test_refusals(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(UnreadableFileError, match=said):
        read_feature_points(path, 4)
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_feature_points(tmp_path / "none.csv")
