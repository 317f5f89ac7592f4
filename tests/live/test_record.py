"""A live session's record: repeated bit by bit, readable wherever it ends, and never in the session's way."""

import json
import multiprocessing
import time
from collections.abc import Iterable
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from haptic_toy import FollowingTool
from live_toy import LiveToy, arrival, arrivals_of, pose_message
from toy_session import (
    ECG_HZ,
    HOME,
    LAG_S,
    TIP,
    bits,
    compare_known,
    register_known,
    toy_heart,
    toy_setup,
    toy_streams,
)
from waiting import WITHIN_S

from dvf_ig.core import ImageMap, OutputError, Preop, Rigid, UnreadableFileError
from dvf_ig.guidance import DeviceLimits, FixtureOptions, FixtureSet, Gaussian, PathTarget
from dvf_ig.guidance.margins import MarginOptions
from dvf_ig.intake.live import BreathMarkerConfig, EcgFieldConfig, LiveConfig
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.readers import StartFiles
from dvf_ig.intake.session_log.document import DOCUMENT, attach_heart, document_of_live
from dvf_ig.intake.session_log.live import LIVE, LiveDocument, live_document
from dvf_ig.intake.session_log.read import read_session_log
from dvf_ig.io.ros.log_file import LogWriter
from dvf_ig.live.answers import state_messages
from dvf_ig.live.igtl import Message, Status
from dvf_ig.live.link import Arrival
from dvf_ig.live.record import LOG, PART, CountedWork, SessionRecord, session_record
from dvf_ig.replay.repetition import AsRecorded, recorded_ticks, repeat
from dvf_ig.session import UNFOLLOWED, GuidanceState, Session, ThreadedExecutor, ToolPose

pytest.importorskip("mcap", reason="session logs need mcap")
pytest.importorskip("rosbags", reason="session logs need rosbags")
UNTIL_S = 14.5
LINE = ((0.0, 0.1, 0.2), (1.0, 2.0, 3.0))


def patient() -> SessionFiles:
    return SessionFiles(
        preop=PreopFiles(Preop("ball"), toy_heart().model),
        probe=ImageMap(Rigid.identity("probe", "image"), np.array([4.0, 4.0])),
        latency=LAG_S,
        tip=TIP,
        start=StartFiles(HOME),
        live=LiveConfig(
            ecg=EcgFieldConfig(rate_hz=ECG_HZ), respiration=BreathMarkerConfig(marker="ChestToTracker")
        ),
    )


def attach(log: LogWriter) -> None:
    setup, of = toy_setup(), patient()
    preop = attach_heart(log, of.heart, setup.heart.model)
    held = setup.calibrations
    log.attach(DOCUMENT, "application/json", document_of_live(of, held.probe_from_image, LAG_S, TIP, preop))
    log.attach(LIVE, "application/json", live_document(setup.fixtures, setup.retiming, 7))


def recorded(
    folder: Path,
    told: list[str],
    until_s: float,
    haptic: FollowingTool | None = None,
    breath: Iterable[Arrival] = (),
) -> list[GuidanceState]:
    """A session of the toy's patient with its record in a folder; what it said."""
    states: list[GuidanceState] = []
    with (
        session_record(folder, attach, told.append) as record,
        ThreadedExecutor(waits=False) as beside,
        Session(toy_setup(), executor=CountedWork(beside, record)) as session,
    ):
        toy, kept = LiveToy(session), record.state

        def state(one: GuidanceState) -> None:
            states.append(one)
            kept(one)

        setattr(record, "state", state)  # noqa: B010
        toy.loop.record = record
        toy.loop.haptic = cast(Any, haptic)
        arrivals = [*arrivals_of(toy_streams(until_s, chunk=5)), *breath]
        arrivals.sort(key=lambda one: one.arrived_s)
        toy.run(arrivals, until_s - 1.0)
        toy.loop.ask_rearm()
        toy.run(arrivals, until_s)
    return states


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, told: list[str]) -> tuple[Path, list[GuidanceState]]:
    folder = tmp_path_factory.mktemp("record")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
        patch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
        return folder, recorded(folder, told, UNTIL_S)


def read(path: Path) -> SessionFiles:
    found = read_session_log(path)
    assert found.record is not None
    return found


@pytest.mark.usefixtures("known_images")
def test_repeated_from_its_record_a_session_says_the_same_to_the_last_bit(
    run: tuple[Path, list[GuidanceState]], told: list[str]
) -> None:
    folder, states = run
    assert told == []
    assert [file.name for file in folder.iterdir()] == [LOG]
    found = read(folder / LOG)
    live = found.record
    assert live is not None
    assert live.seed == 7
    assert live.findings == ()
    again: list[GuidanceState] = []
    with Session(toy_setup(), executor=AsRecorded(live.refused)) as session:
        repeat(session, live, lambda _, state: again.append(state))
    assert [bits(a) for a in again] == [bits(b) for b in states]
    assert any(state.force_n.any() for state in again)
    assert again[-1].rearmed is not None


@pytest.mark.usefixtures("known_images")
def test_session_whose_tool_is_a_haptic_device_is_repeated_too(tmp_path: Path) -> None:
    haptic = FollowingTool()
    states = recorded(tmp_path, [], 4.0, haptic)
    assert haptic.published == len(states)
    live = read(tmp_path / LOG).record
    assert live is not None
    poses = [step[0] for step in live.steps if isinstance(step, tuple) and isinstance(step[0], ToolPose)]
    assert len(poses) > 100
    assert all(pose.by_encoders for pose in poses)
    again: list[GuidanceState] = []
    with Session(toy_setup(), executor=AsRecorded(live.refused)) as session:
        repeat(session, live, lambda _, state: again.append(state))
    assert [bits(a) for a in again] == [bits(b) for b in states]


def last_of_each_moment(states: list[GuidanceState]) -> list[GuidanceState]:
    """After a re-arming there may be two."""
    return [one for one, then in pairwise([*states, None]) if one and (not then or then.now_s > one.now_s)]


@pytest.mark.usefixtures("known_images")
def test_session_that_follows_the_breath_is_repeated_too(tmp_path: Path) -> None:
    times = np.arange(0.0, 13.0, 0.04).tolist()

    def chest(t_s: float) -> Message:
        matrix = np.eye(4)
        matrix[:2, 3] = 100.0, 8.0 * max(0.0, np.sin(1.5 * t_s))
        return pose_message("ChestToTracker", t_s, matrix)

    states = recorded(tmp_path, [], 13.0, breath=[arrival(t_s, chest(t_s)) for t_s in times])
    found = read(tmp_path / LOG)
    assert found.respiration is not None
    assert len(found.respiration) == len(times)
    again: list[GuidanceState] = []
    assert found.record is not None
    with Session(toy_setup(), executor=AsRecorded(found.record.refused)) as session:
        repeat(session, found.record, lambda _, state: again.append(state))
    assert [bits(a) for a in again] == [bits(b) for b in states]
    ticks = recorded_ticks(found.record)
    last = last_of_each_moment(states)
    np.testing.assert_array_equal(ticks.breath_state, [state.breath.state for state in last])
    assert ticks.breath_state[-1] != UNFOLLOWED


def test_record_holds_what_was_answered_and_what_was_sent(run: tuple[Path, list[GuidanceState]]) -> None:
    folder, states = run
    found = read(folder / LOG)
    assert found.record is not None
    ticks = recorded_ticks(found.record)
    states = last_of_each_moment(states)
    np.testing.assert_array_equal(ticks.force_n, [state.force_n for state in states])
    np.testing.assert_array_equal(ticks.status, [state.status for state in states])
    np.testing.assert_array_equal(ticks.phase.phi, [state.phase.phi for state in states])
    scenario, streams = found.scenario, toy_streams(UNTIL_S)
    assert scenario.ultrasound.images is not None
    sent = {frame.image.tobytes() for frame in streams.frames if frame.image is not None}
    assert {image.tobytes() for image in scenario.ultrasound.images} <= sent
    assert len(scenario.ultrasound) > 0.9 * len(streams.frames)
    assert scenario.tool is not None
    assert scenario.tool.valid.all()
    assert found.model is not None


def test_record_is_read_by_the_decoder_of_another_package(run: tuple[Path, list[GuidanceState]]) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support decodes independently")
    from mcap.reader import make_reader

    with (run[0] / LOG).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        topics = {channel.topic for _, channel, _, _ in reader.iter_decoded_messages()}
    assert {"/tf", "/ultrasound/image", "/ecg", "/tool/force", "/guidance", "/diagnostics"} <= topics


def test_what_was_written_before_a_log_ends_is_read_and_nothing_else(
    run: tuple[Path, list[GuidanceState]], tmp_path: Path
) -> None:
    """Cut anywhere: a first part of the states, with a warning, under the name of an unfinished log alone."""
    folder, states = run
    data, counts = (folder / LOG).read_bytes(), []
    for share in (0.02, 0.3, 0.61, 0.97):
        part = tmp_path / PART
        part.write_bytes(data[: int(share * len(data))])
        try:
            found = read(part)
        except UnreadableFileError:
            counts.append(0)
            continue
        assert found.record is not None
        n = len(found.record.states)
        np.testing.assert_array_equal(found.record.states[:, 0], [state.now_s for state in states[:n]])
        assert ["not finished" in one.sentence for one in found.record.findings] == [True]
        counts.append(n)
    assert counts == sorted(counts)
    assert counts[0] < 0.3 * len(states)
    assert 0.3 * len(states) < counts[-1]
    (tmp_path / "session.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(UnreadableFileError, match="truncated"):
        read_session_log(tmp_path / "session.mcap")


def keep_recording(folder: Path, states: list[GuidanceState], started: Any) -> None:
    """In another process, until it is killed."""
    frame = toy_streams(0.1).frames[0]
    with session_record(folder, attach, print) as record:
        for n, state in enumerate(states):
            record.event(ToolPose(state.now_s, np.eye(4)), state.now_s)
            record.event(frame, state.now_s)
            record.state(state)
            if n == 800:
                started.set()
            time.sleep(0.001 if n < 800 else 0.1)


def test_killed_while_it_records(run: tuple[Path, list[GuidanceState]], tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    started = context.Event()
    child = context.Process(target=keep_recording, args=(tmp_path, run[1], started), daemon=True)
    child.start()
    assert started.wait(60.0)
    time.sleep(0.3)
    child.kill()
    child.join()
    assert [file.name for file in tmp_path.iterdir()] == [PART]
    live = read(tmp_path / PART).record
    assert live is not None
    assert 400 < len(live.states) < len(run[1])
    assert live.states[:, 0].tolist() == [state.now_s for state in run[1][: len(live.states)]]
    with pytest.raises(OutputError, match="never replaced"), session_record(tmp_path, attach, print):
        pass


def test_a_session_that_fails_keeps_what_came_before(tmp_path: Path) -> None:
    def fail() -> None:
        with session_record(tmp_path, attach, print) as record:
            record.event(ToolPose(0.0, np.eye(4)), 0.0)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert [file.name for file in tmp_path.iterdir()] == [PART]


class FullDisk(BytesIO):
    """Takes so many bytes."""

    left = 200_000

    def write(self, data: Any) -> int:
        self.left -= len(data)
        if self.left < 0:
            raise OSError(28, "No space left on device")
        return super().write(data)


def test_full_disk_ends_the_record_and_is_told_but_the_session_goes_on() -> None:
    told: list[str] = []
    stream = FullDisk()
    record = SessionRecord(LogWriter(stream, 1000), stream, Path(PART), told.append)
    record.start()
    with Session(toy_setup()) as session:
        deadline = time.monotonic() + WITHIN_S
        n = 0
        while record.problem is None and time.monotonic() < deadline:
            n += 1
            record.event(ToolPose(n * 0.01, np.eye(4)), n * 0.01)
            time.sleep(0.0001)
        state = session.state(n * 0.01)
        record.state(state)
    assert not record.finish()
    assert record.failure is not None
    assert told == [record.problem]
    assert "No space left" in told[0]
    assert "session goes on" in told[0]
    status, text = state_messages(state, 1.0, record.problem)
    assert isinstance(status.content, Status)
    assert "No space left" in status.content.text
    assert record.problem in json.loads(text.content.text)["reasons"]  # type: ignore[union-attr]


def test_a_disk_that_is_full_before_the_session_begins_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Closing the file fails once more, with what it did not take."""

    def full(path: Path, *_: Any) -> Any:
        path.touch()
        return open("/dev/full", "wb")

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OutputError, match="No space left"), session_record(tmp_path, attach, print):
        pass
    assert list(tmp_path.iterdir()) == []


def test_disk_that_is_too_slow_loses_messages_that_are_counted_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is written before all has been handed over."""
    monkeypatch.setattr("dvf_ig.live.record.MOST_WAITING_BYTES", 50_000)
    told: list[str] = []
    with (tmp_path / LOG).open("wb") as stream, Session(toy_setup()) as session:
        log = LogWriter(stream)
        attach(log)
        log.end_attachments()
        record = SessionRecord(log, stream, tmp_path / LOG, told.append)
        frame, state = toy_streams(0.1).frames[0], session.state(1.0)
        record.event(ToolPose(0.0, np.eye(4)), 0.0)
        record.state(state)
        for n in range(100):
            record.event(ToolPose(n * 0.01, np.eye(4)), n * 0.01)
            record.event(frame, n * 0.01)
        lost = record.lost
        record.start()
        assert record.finish()
    assert lost > 100
    assert told == [record.problem]
    assert f"{lost} messages" in told[0]
    live = read(tmp_path / LOG).record
    assert live is not None
    assert [f"lacks {lost} messages" in one.sentence for one in live.findings] == [True]


def test_folder_that_cannot_be_written_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    def fails(log: LogWriter) -> None:
        attach(log)
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left"), session_record(tmp_path, fails, print):
        pass
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="does not exist"), session_record(tmp_path / "no", attach, print):
        pass


@pytest.mark.parametrize(
    "fixtures",
    [
        FixtureSet(),
        FixtureSet(
            (
                FixtureOptions(Gaussian(2.5, 1.5, 0.4, 1.0), "distance", name="wall"),
                FixtureOptions(
                    Gaussian(4.0),
                    path=PathTarget.static("mr", ((0.0, 0.1, 0.2), (1.0, 2.0, 3.0))),
                    name="cut",
                ),
            ),
            0.7,
            MarginOptions("fixed", fixed_mm=1.25),
        ),
        FixtureSet(
            (FixtureOptions(Gaussian(10.0, cap_n=9.0)),),
            device=DeviceLimits(stiffness_n_per_m=3000.0, continuous_force_n=12.0, name="omega.3"),
        ),
    ],
)
def test_fixtures_come_back_as_they_were(fixtures: FixtureSet) -> None:
    content = json.loads(live_document(fixtures, "uniform", 3))
    back = LiveDocument.model_validate(content)
    found = back.fixtures.fixture_set(Path())
    assert (back.retiming, back.seed) == ("uniform", 3)
    assert found.cap_n == fixtures.cap_n
    assert found.margin == fixtures.margin
    assert found.device == fixtures.device
    for one, other in zip(found.fixtures, fixtures.fixtures, strict=True):
        assert (one.law, one.blend, one.name) == (other.law, other.blend, other.name)
        if other.path is not None and one.path is not None:
            np.testing.assert_array_equal(one.path.points_mm, other.path.points_mm)
