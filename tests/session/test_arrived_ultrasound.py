"""Arrived frames are checked and kept, and become jobs of an executor."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import pytest
from toy_session import CENTER, HOME, LAG_S, RR_S, frame_events, toy_heart, toy_setup

from dvf_ig.cardiac import RPeak
from dvf_ig.core import Fan, FloatArray, InvalidInputError
from dvf_ig.core.space.rigid import is_rigid
from dvf_ig.registration import PoseEstimate, SliceThreads
from dvf_ig.session import TrackedFrame
from dvf_ig.session.arrived_ultrasound import AROUND_S, KEEP_S, SETTLED_IMAGES, ArrivedUltrasound, FrameBuffer
from dvf_ig.session.ultrasound_registration import RegistrationRequest
from dvf_ig.session.work import InlineExecutor, Job

T = TypeVar("T")
AT_HOME = PoseEstimate(HOME, np.eye(6), CENTER, np.eye(6))
PEAKS = tuple(RPeak(0.4 + RR_S * k, 0.52 + RR_S * k, 1.0) for k in range(14))


@dataclass
class Counting:
    """Does the work when its result is taken, and counts what it was given."""

    submitted: list[object] = field(default_factory=list)

    def submit(self, work: Callable[[], T]) -> Job[T]:
        self.submitted.append(work)
        return InlineExecutor().submit(work)


def source_of(
    frames: list[TrackedFrame], executor: Counting, *, fan: Fan | None = None, lag_s: float = LAG_S
) -> ArrivedUltrasound:
    setup = toy_setup()
    buffer = FrameBuffer()
    for frame in frames:
        buffer.push(frame)
    calibrations = replace(setup.calibrations, lag_s=lag_s)
    return ArrivedUltrasound(
        buffer, toy_heart(), calibrations, fan, "two-segment", 0, lambda: 0.0, SliceThreads(), executor
    )


def request(from_s: float, until_s: float, peaks: tuple[RPeak, ...] = PEAKS) -> RegistrationRequest:
    return RegistrationRequest(from_s, until_s, HOME, False, None, peaks)


SETUP = toy_setup()


@pytest.mark.usefixtures("known_ultrasound")
@pytest.mark.parametrize("lag_s", [-0.06, 0.06])
def test_a_registration_takes_the_frames_whose_event_lies_in_its_time(lag_s: float) -> None:
    executor = Counting()
    source = source_of(frame_events(10.0), executor, fan=SETUP.fan, lag_s=lag_s)
    job = source.register(request(2.0, 6.0), known_s=6.35)
    assert len(executor.submitted) == 1
    answer = job.result()
    assert answer.failure is None
    assert answer.result is not None
    assert answer.frames is not None
    event_s = answer.frames.event_s
    assert event_s[0] >= 2.0 > event_s[0] - 1 / 20
    assert event_s[-1] < 6.0 <= event_s[-1] + 1 / 20 + 1e-9
    assert answer.frames.first_number + len(event_s) < 10.0 * 20
    np.testing.assert_allclose(
        event_s - lag_s, (answer.frames.first_number + np.arange(len(event_s))) / 20 + 0.003
    )


@pytest.mark.usefixtures("known_ultrasound")
def test_frames_that_are_recorded_after_the_moment_of_asking_take_no_part() -> None:
    frames = frame_events(10.0)
    for job in (
        source_of(frames, Counting(), fan=SETUP.fan).register(request(2.0, 6.0), known_s=5.0),
        source_of([f for f in frames if f.t_s <= 5.0], Counting(), fan=SETUP.fan).register(
            request(2.0, 6.0), known_s=6.35
        ),
    ):
        answer = job.result()
        assert answer.frames is not None
        assert answer.frames.event_s[-1] <= 5.0 + LAG_S


@pytest.mark.usefixtures("known_ultrasound")
def test_what_needs_no_work_is_answered_at_once_with_its_reason() -> None:
    executor = Counting()
    empty = source_of([], executor, fan=SETUP.fan).register(request(2.0, 6.0), 6.35).result()
    assert (empty.frames, empty.result) == (None, None)
    assert empty.failure == "no ultrasound image has arrived"
    few = source_of(frame_events(2.4), executor, fan=SETUP.fan).register(request(2.0, 6.0), 6.35).result()
    assert few.failure is None
    assert few.result is None
    assert few.frames is not None
    assert "needed at least 16" in few.frames.shortage
    beat = source_of([], executor, fan=SETUP.fan).beat(PEAKS[:3], 3.0, AT_HOME, in_use=True).result()
    assert (beat.slices, beat.evaluation, beat.irregular) == (None, None, False)
    assert not executor.submitted


def test_a_registration_that_fails_is_answered_with_the_sentence(known_ultrasound: None) -> None:
    black = [
        replace(f, image=np.where(np.indices((24, 24)).sum(0) == 0, 0, f.image).astype(np.uint8))
        for f in frame_events(10.0)
    ]
    answer = source_of(black, Counting(), fan=SETUP.fan).register(request(2.0, 6.0), 6.35).result()
    assert answer.result is None
    assert answer.frames is not None
    assert answer.failure == "the images are black"


@pytest.mark.parametrize("fan", [SETUP.fan, None], ids=["known sector", "sector from the images"])
@pytest.mark.parametrize("tested", [AT_HOME, None], ids=["pose", "no pose"])
def test_black_images_neither_confirm_nor_end_anything(fan: Fan | None, tested: PoseEstimate | None) -> None:
    """With the method itself: nothing to register and nothing to compare, in a sentence or in silence."""
    black = [replace(f, image=np.zeros((24, 24), dtype=np.uint8)) for f in frame_events(10.0)]
    source = source_of(black, Counting(), fan=fan)
    beat = source.beat(PEAKS[:6], 5.0, tested, in_use=tested is not None).result()
    assert beat.evaluation is None or beat.evaluation.measurement.log_likelihood_ratio == 0.0
    answer = source.register(request(2.0, 6.0), 6.35).result()
    assert answer.result is None or not answer.result.stop.usable


@pytest.mark.usefixtures("known_ultrasound")
def test_a_beat_takes_the_frames_between_its_peaks() -> None:
    def patient(t_s: float) -> np.ndarray:
        inside = PEAKS[4].t_s <= t_s < PEAKS[5].t_s
        return np.array([0.0, 0.0, 0.0, 2.0 if inside else 9.0, 0.0, 0.0])

    executor = Counting()
    source = source_of(frame_events(10.0, patient=patient), executor, fan=SETUP.fan)
    compared = source.beat(PEAKS[:6], PEAKS[5].detected_at_s + 0.05, AT_HOME, in_use=True).result()
    assert len(executor.submitted) == 1
    assert compared.evaluation is not None
    best = compared.evaluation.measurement.best
    moved = best.apply_array(HOME.inverse().apply_array(CENTER[None]))[0] - CENTER
    np.testing.assert_allclose(moved, [2.0, 0.0, 0.0], atol=1e-9)
    assert source.beat(PEAKS[:6], 5.0, None, in_use=False).result().evaluation is None


# ------------------------------------------------------------------ the buffer

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
