"""Frames that have arrived: numbered, in order, as a sequence of any part, and forgotten in time."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.space.rigid import is_rigid
from dvf_ig.session import TrackedFrame
from dvf_ig.session.arrived_ultrasound import AROUND_S, KEEP_S, SETTLED_IMAGES, FrameBuffer

STEP_S = 0.1
NO_PLACE = np.eye(4)
NO_PLACE[0, 3] = np.nan


def frame(k: int, *, pose: FloatArray | None = None) -> TrackedFrame:
    matrix = np.eye(4)
    matrix[0, 3] = k
    return TrackedFrame(
        STEP_S * k, np.full((2, 3), k % 256, dtype=np.uint8), matrix if pose is None else pose
    )


def filled(count: int) -> FrameBuffer:
    buffer = FrameBuffer()
    assert not buffer.any
    for k in range(count):
        assert buffer.push(frame(k))
    assert buffer.any
    return buffer


def test_a_part_holds_the_frames_around_it_and_nothing_later() -> None:
    part = filled(50).between(2.0, 3.0)
    assert part is not None
    sequence, first = part
    assert first == round((2.0 - AROUND_S) / STEP_S + 0.5)
    np.testing.assert_allclose(sequence.t_s, STEP_S * np.arange(first, 31))
    assert sequence.images is not None
    np.testing.assert_array_equal(sequence.images[:, 1, 2], np.arange(first, 31))
    stream = sequence.stream("tracker", "probe")
    np.testing.assert_array_equal(stream.translations_mm[:, 0], np.arange(first, 31))
    assert stream.valid.all()


def test_numbers_go_on_when_old_frames_are_forgotten() -> None:
    buffer = filled(500)
    buffer.advance(49.9)
    part = buffer.between(-np.inf, np.inf)
    assert part is not None
    sequence, first = part
    assert sequence.t_s[0] == pytest.approx(49.9 - KEEP_S)
    assert first == 299
    assert len(sequence.t_s) == 201


def test_frames_that_were_pushed_ahead_are_kept_until_their_time_has_passed() -> None:
    buffer = filled(500)
    buffer.advance(1.0)
    part = buffer.between(0.0, 1.0)
    assert part is not None
    assert part[1] == 0


def test_a_frame_that_is_not_later_is_dropped() -> None:
    buffer = filled(3)
    assert not buffer.push(frame(2))
    assert not buffer.push(frame(1))
    part = buffer.between(0.0, 1.0)
    assert part is not None
    assert len(part[0].t_s) == 3


@pytest.mark.parametrize(
    "pose",
    [np.full((4, 4), np.nan), NO_PLACE, np.diag([1.01, 1.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])],
)
def test_what_is_no_rigid_pose_counts_as_not_tracked(pose: FloatArray) -> None:
    assert not is_rigid(pose)
    buffer = filled(2)
    buffer.push(frame(2, pose=pose))
    buffer.push(TrackedFrame(0.3, np.zeros((2, 3), dtype=np.uint8), None))
    part = buffer.between(0.0, 1.0)
    assert part is not None
    stream = part[0].stream("tracker", "probe")
    assert stream.valid.tolist() == [True, True, False, False]
    assert np.isfinite(stream.translations_mm).all()


def test_frames_without_image_are_blank_and_invalid() -> None:
    buffer = FrameBuffer()
    buffer.push(TrackedFrame(0.0, None, np.eye(4)))
    assert buffer.between(0.0, 1.0) is None
    buffer.push(frame(1))
    part = buffer.between(0.0, 1.0)
    assert part is not None
    assert part[0].image_valid.tolist() == [False, True]
    assert part[0].images is not None
    assert part[0].images.shape == (2, 2, 3)
    assert buffer.between(5.0, 6.0) is None


def test_another_image_size_is_refused_and_changes_nothing() -> None:
    buffer = filled(SETTLED_IMAGES)
    wrong = TrackedFrame(1.5, np.zeros((3, 3), dtype=np.uint8), np.eye(4))
    with pytest.raises(InvalidInputError, match=r"frame at 1\.500 s is \(3, 3\) pixels.*new session"):
        buffer.push(wrong)
    assert buffer.push(frame(SETTLED_IMAGES))


def test_a_first_image_of_another_size_decides_nothing() -> None:
    """The scanner's first images may be anything: what comes after them, ten in a row, is the size."""
    buffer = FrameBuffer()
    for k, shape in enumerate([(1, 1), (9, 9), (9, 9)]):
        assert buffer.push(TrackedFrame(STEP_S * (k - 3), np.zeros(shape, dtype=np.uint8), np.eye(4)))
    for k in range(SETTLED_IMAGES):
        assert buffer.push(frame(k))
    part = buffer.between(-1.0, 5.0)
    assert part is not None
    assert part[0].image_valid.tolist() == [False] * 3 + [True] * SETTLED_IMAGES
    with pytest.raises(InvalidInputError, match="new session"):
        buffer.push(TrackedFrame(9.0, np.zeros((9, 9), dtype=np.uint8), np.eye(4)))
