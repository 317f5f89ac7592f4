"""The contact sheet of segmented wires: which frames it shows, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.calibration import RejectedFrame, Rejection, WireSegmentation
from dvf_ig.calibration.wires.dots import Dots
from dvf_ig.calibration.wires.images import WireFrame
from dvf_ig.core import InvalidInputError, TrackedSequence
from dvf_ig.report import write_wire_picture
from dvf_ig.report.wires import MOST_REFUSED, chosen_frames


def refused(count: int) -> WireSegmentation:
    frame = WireFrame(Dots(np.zeros((0, 2)), np.zeros(0)), RejectedFrame(Rejection.TOO_FEW_DOTS, "0 dots"))
    return WireSegmentation(0.1, (frame,) * count, np.full((count, 9, 2), np.nan))


def test_frames_are_spread_over_the_recording() -> None:
    chosen = chosen_frames(refused(100))
    assert len(chosen) == MOST_REFUSED
    assert (chosen[0], chosen[-1]) == (0, 99)
    assert chosen_frames(refused(3)) == [0, 1, 2]


def test_the_sheet_is_of_the_sequence_that_was_segmented(tmp_path: Path) -> None:
    sequence = TrackedSequence(np.arange(3.0), np.zeros((3, 8, 10), np.uint8), np.ones(3, np.bool_), {})
    write_wire_picture(tmp_path / "a.png", sequence, refused(3), title="wires")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InvalidInputError, match="3 images, the segmentation 4 frames"):
        write_wire_picture(tmp_path / "b.png", sequence, refused(4), title="wires")
    with pytest.raises(InvalidInputError, match=r"does not end in \.png"):
        write_wire_picture(tmp_path / "b.jpg", sequence, refused(3), title="wires")
