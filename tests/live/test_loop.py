"""A live session on the toy's patient: what it sends, and what it does when a source fails."""

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from haptic_toy import FollowingTool
from live_toy import LATENCY_S, ORIGIN_S, LiveToy, arrival, arrivals_of
from toy_session import CENTER, GUIDED_S, HOME, compare_breathing, run, toy_setup, toy_streams

from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.live.igtl import Message, StatusCode, Text, Transform, WireError, WireProblem, decode, encode
from dvf_ig.live.igtl import Status as StatusMessage
from dvf_ig.live.link import Arrival
from dvf_ig.live.loop import LiveLoop
from dvf_ig.live.serve import SessionThread
from dvf_ig.live.summary import LiveSummary
from dvf_ig.registration import PoseChart
from dvf_ig.session import Session

UNTIL_S = 14.5
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.fixture
def toy(known_images: None) -> Iterator[LiveToy]:
    with Session(toy_setup(), latch_after_s=VALID_FOR_S) as session:
        yield LiveToy(session, guided_from_s=11.0)


def streams_of(until_s: float) -> list[Arrival]:
    return list(_streams_of(until_s))


@cache
def _streams_of(until_s: float) -> tuple[Arrival, ...]:
    return tuple(arrivals_of(toy_streams(until_s, chunk=25)))


def without(arrivals: list[Arrival], device: str, from_s: float, until_s: float) -> list[Arrival]:
    """The same without a device's messages in a span."""
    return [
        a
        for a in arrivals
        if not (isinstance(a.taken, Message) and a.taken.device == device and from_s < a.arrived_s < until_s)
    ]


def loop_of(toy: LiveToy) -> Any:
    """The loop with the counts of a link that runs."""
    return replace(toy.loop, link=SimpleNamespace(connections=1, turned_away=0, dropped=0))


def states(toy: LiveToy, from_s: float, until_s: float) -> list[SupervisorState]:
    return [a.state.supervisor for a in toy.answers if from_s < a.state.now_s < until_s]


@pytest.mark.usefixtures("known_images")
def test_live_session_says_what_a_session_that_is_pushed_says(clean):
    """The peer's clock is put to the local one so that the latency counts as none."""
    live = [a.state for a in clean.answers]
    with Session(toy_setup(), latch_after_s=VALID_FOR_S) as session:
        direct = run(session, toy_streams(UNTIL_S, chunk=5).merged(), [s.now_s - LATENCY_S for s in live])
    pairs = [(a, b) for a, b in zip(live, direct, strict=True) if a.now_s > 1.3]
    assert len(pairs) > 600
    same = [a.status is b.status and a.supervisor is b.supervisor for a, b in pairs]
    assert np.mean(same) > 0.98
    guided = [(a, b) for a, b in pairs if a.now_s > GUIDED_S + 0.5]
    assert all(a.status is Status.OK for a, _ in guided)
    apart = [np.linalg.norm(a.force_n - b.force_n) for a, b in guided]
    assert np.max(apart) < 0.005 < np.median([np.linalg.norm(b.force_n) for _, b in guided])
    assert clean.told == []


def test_answers_are_what_slicer_and_plus_expect(clean):
    """The pose takes the tracker's coordinates as they came to RAS; the force lies along its axes."""
    pose, force = clean.sent.named("MrFromTracker")[-1], clean.sent.named("ToolForce")[-1]
    assert isinstance(pose.content, Transform)
    assert isinstance(force.content, Transform)
    np.testing.assert_allclose(pose.content.matrix, RAS_FROM_LPS @ HOME.matrix, atol=0.2)
    answer = clean.answers[-1]
    np.testing.assert_array_equal(force.content.matrix[:3, 3], answer.state.force_n)
    np.testing.assert_array_equal(force.content.matrix[:3, :3], np.eye(3))
    assert force.stamp_s is not None
    assert abs(force.stamp_s - ORIGIN_S - UNTIL_S) < 0.05
    forces = clean.sent.named("ToolForce")
    assert len(forces) <= 60 * (UNTIL_S - 1.0) + 1
    assert len(forces) > 45 * (UNTIL_S - 1.2)
    first = clean.sent.named("MrFromTracker")[0].stamp_s
    assert first is not None
    assert first - ORIGIN_S > 11.0
    status = clean.sent.named("DvfIg")[-1].content
    assert isinstance(status, StatusMessage)
    assert (status.code, status.name) == (StatusCode.OK, "OK")
    text = clean.sent.named("DvfIgState")[-1].content
    assert isinstance(text, Text)
    said = json.loads(text.text)
    assert said["servo"] == "OK"
    assert said["phase_state"] == "LOCKED"
    assert said["reasons"] == []


def test_latency_is_from_the_newest_tool_pose(clean):
    latencies = np.array([a.latency_s for a in clean.answers[10:]])
    assert np.nanmin(latencies) >= 0.0
    assert np.nanmax(latencies) < 0.012


def test_lost_tool_fades_and_comes_back(toy):
    """Poses that are said to be missing for 0.2 s, and then none at all."""
    streams = toy_streams(15.5, chunk=25)
    missing = [p if p.t_s < 13.5 or p.t_s > 13.7 else type(p)(p.t_s, None) for p in streams.tool]
    streams.tool = [p for p in missing if not 13.7 < p.t_s < 13.9]
    toy.run(arrivals_of(streams), 15.5)
    assert SupervisorState.OK in states(toy, 13.3, 13.5)
    assert states(toy, 13.65, 13.9)[0] is SupervisorState.FADE
    gone = [a for a in toy.answers if 13.85 < a.state.now_s < 13.9]
    assert all(np.linalg.norm(a.state.force_n) == 0.0 for a in gone)
    assert states(toy, 15.0, 15.5)[-1] is SupervisorState.OK
    assert np.linalg.norm(toy.answers[-1].state.force_n) > 0.02


def test_tool_that_was_long_gone_needs_the_operator(toy):
    """Nothing that a peer sends re-arms; the operator at this machine does, where little force is wanted."""
    streams = toy_streams(16.5, chunk=25)
    streams.tool = [p for p in streams.tool if not 13.0 < p.t_s < 14.5]
    arrivals = arrivals_of(streams)
    toy.run(arrivals, 16.0)
    assert states(toy, 15.5, 16.0)[-1] is SupervisorState.LATCHED
    assert toy.answers[-1].state.supervisor is SupervisorState.LATCHED
    assert toy.sent.named("DvfIg")[-1].content.code == StatusCode.DISABLED
    toy.loop.ask_rearm()
    toy.run(arrivals, 16.5)
    assert toy.answers[-1].state.rearmed is not None


def test_tool_pose_that_is_not_finite_latches(toy):
    arrivals = streams_of(14.5)
    bad = WireError(WireProblem.NOT_FINITE, "TRANSFORM", "ToolToTracker", 13.5 + ORIGIN_S)
    arrivals = without(arrivals, "ToolToTracker", 13.5, 13.508)
    arrivals.append(arrival(13.5, bad))
    arrivals.sort(key=lambda a: a.arrived_s)
    toy.run(arrivals, 14.5)
    assert states(toy, 13.3, 13.48)[-1] is SupervisorState.OK
    assert states(toy, 14.0, 14.5)[-1] is SupervisorState.LATCHED
    assert "not finite" in toy.told[0]


@pytest.mark.parametrize("stopped_s", [0.06, 0.12, 0.4, 1.3])
def test_a_session_that_was_stopped_sends_zero_first_and_latches(toy, stopped_s):
    """Beyond 0.1 s nothing that the hand has felt since is known."""
    arrivals = streams_of(15.5)
    toy.run(arrivals, 13.5)
    before = toy.answers[-1]
    assert before.state.supervisor is SupervisorState.OK
    toy.now_s = round(toy.now_s + stopped_s, 9)
    toy.run(arrivals, 15.5)
    first = toy.answers[toy.answers.index(before) + 1].state
    size_n, old_n = np.linalg.norm(first.force_n), np.linalg.norm(before.state.force_n)
    silent = stopped_s > VALID_FOR_S
    assert size_n == 0.0 if silent else size_n > 0.5 * old_n
    for state in (first, toy.answers[-1].state):
        assert (state.supervisor is SupervisorState.LATCHED) == silent
        assert bool(state.supervised.cause & (Hazard.MISSED_DEADLINES | Hazard.SESSION_SILENT)) == silent
        assert state.reasons or not silent
        assert state.force_n.any() != silent
    assert (toy.loop.running_share < 1.0) == silent


def test_a_session_that_was_stopped_before_any_force_gives_one_without_an_operator(toy):
    """As on a new machine, which compiles meanwhile: the hand has felt nothing."""
    arrivals = streams_of(14.5)
    for stop_s in (0.5, 3.0):
        toy.run(arrivals, stop_s)
        toy.now_s = round(toy.now_s + 1.3, 9)
    toy.run(arrivals, 14.5)
    assert not any(a.state.force_n.any() for a in toy.answers if a.state.now_s < 4.3)
    assert toy.answers[-1].state.supervisor is SupervisorState.OK
    assert toy.answers[-1].state.force_n.any()


BREATH_S, EXCURSION_MM = 2.5, 6.0


def breathing(t_s: float) -> np.ndarray:
    """Coordinates of a heart that moves along x, and rests for half of each breath."""
    return np.array(
        [0.0, 0.0, 0.0, EXCURSION_MM * max(0.0, np.sin(2 * np.pi * t_s / BREATH_S)) ** 2, 0.0, 0.0]
    )


def breath_message(t_s: float, *, by_marker: bool) -> Message:
    if by_marker:
        matrix = np.eye(4)
        matrix[:2, 3] = 100.0, 1.5 * breathing(t_s)[3]
        return Message("ChestToTracker", t_s + ORIGIN_S, Transform(matrix))
    return Message("Pressure", t_s + ORIGIN_S, Text(f"{5.0 + breathing(t_s)[3]:.9g}"))


@pytest.mark.parametrize("by_marker", [True, False])
def test_the_pose_follows_the_breath_that_arrives_and_is_withheld_when_it_stops(toy, monkeypatch, by_marker):
    """Five breaths teach the motion here; the surrogate ends at 36 s, and breathing goes on."""
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_breathing)
    monkeypatch.setattr("dvf_ig.session.breathing_motion.TRUSTED_BREATHS", 5)
    streams = toy_streams(37.0, patient=breathing, chunk=25)
    arrivals = arrivals_of(streams)
    times = np.arange(0.0, 36.0, 0.04).tolist()
    arrivals += [arrival(t_s, breath_message(t_s, by_marker=by_marker)) for t_s in times]
    toy.run(sorted(arrivals, key=lambda one: one.arrived_s), 37.0)
    assert toy.told == []
    said = [a.state for a in toy.answers]
    gated = [s for s in said if 26.5 < s.now_s < 30.5]
    withheld = [bool(s.hazards & Hazard.BREATHING) for s in gated]
    assert 0.1 < np.mean(withheld) < 0.9
    assert all(w for s, w in zip(gated, withheld, strict=True) if breathing(s.now_s)[3] > 2.0)
    served = [s for s in said if 32.0 < s.now_s < 36.0 and s.now_s < s.transform.pose_until_s]
    assert len(served) > 0.9 * sum(32.0 < s.now_s < 36.0 for s in said)
    moved = [s.transform.pose.at(s.now_s) @ HOME.inverse() for s in served]
    apart = [
        abs(pose.apply_array(CENTER[None])[0] - CENTER - turned).max()
        for pose, turned in zip(moved, [breathing_shift(s.now_s - LATENCY_S) for s in served], strict=True)
    ]
    assert np.percentile(apart, 95) < 1.0
    lost = [s for s in said if s.now_s > 36.0 - 0.04 + LATENCY_S + 0.5 + 0.02]
    assert len(lost) > 20
    assert all(s.hazards & Hazard.BREATHING for s in lost)


def breathing_shift(t_s: float) -> np.ndarray:
    return (PoseChart(HOME, CENTER).pose(breathing(t_s)) @ HOME.inverse()).apply_array(CENTER[None])[
        0
    ] - CENTER


def test_lost_ecg_loses_the_phase_and_finds_it_again(toy):
    toy.run(without(streams_of(19.0), "EcgData", 13.0, 14.5), 19.0)
    lost = [a for a in toy.answers if 14.2 < a.state.now_s < 14.5]
    assert all(a.state.supervised.hazards & Hazard.NO_PHASE for a in lost)
    assert toy.answers[-1].state.status is Status.OK


def test_pose_that_ultrasound_confirms_no_more_is_withheld(toy):
    """Without images the pose ages until it is not sent any more, and the force has faded."""
    arrivals = without(streams_of(20.0), "Image_Tracker", 13.0, 99.0)
    toy.run(arrivals, 20.0)
    assert toy.answers[-1].state.supervised.hazards & Hazard.POSE_UNCONFIRMED
    assert np.linalg.norm(toy.answers[-1].state.force_n) == 0.0
    last = toy.sent.named("MrFromTracker")[-1].stamp_s
    assert last is not None
    assert last - ORIGIN_S < 19.0


def test_image_of_another_size_is_told_and_does_no_harm(toy):
    from dvf_ig.live.igtl import Image

    arrivals = streams_of(3.0)
    other = Message("Image_Tracker", 2.003 + ORIGIN_S, Image(np.zeros((1, 5, 7), np.uint8), np.eye(4)))
    colour = Message("Image_Tracker", 2.103 + ORIGIN_S, Image(np.zeros((1, 5, 7, 3), np.uint8), np.eye(4)))
    arrivals = without(arrivals, "Image_Tracker", 2.0, 2.02)
    arrivals += [arrival(2.003, other), arrival(2.103, colour)]
    arrivals.sort(key=lambda a: a.arrived_s)
    toy.run(arrivals, 3.0)
    assert len(toy.told) == 2
    assert toy.answers[-1].state.now_s > 2.9


# ------------------------------------------------------------------ ends


def last_of(toy: LiveToy) -> tuple[float, StatusMessage]:
    force, status = toy.sent.messages[-3].content, toy.sent.messages[-2].content
    assert isinstance(force, Transform)
    assert isinstance(status, StatusMessage)
    return float(np.linalg.norm(force.matrix[:3, 3])), status


def test_answers_are_those_of_a_haptic_device_and_its_force_ends_first(toy):
    toy.loop.haptic = haptic = FollowingTool()
    toy.run(arrivals_of(toy_streams(2.0)), 2.0)
    force = toy.sent.named("ToolForce")[-1].content.matrix[:3, 3]
    assert force.tolist() == [0.1, 0.2, 0.3]
    state = json.loads(toy.sent.named("DvfIgState")[-1].content.text)
    assert state["servo"] == "LATCHED"
    assert state["reasons"][0] == "the haptic device does not answer"
    assert toy.answers[-1].supervisor is SupervisorState.LATCHED
    toy.loop.ask_rearm()
    toy.loop.step()
    assert haptic.rearms == 1
    stop = threading.Event()
    stop.set()
    toy.loop.run(stop)
    assert haptic.ended == "the session has ended"


def test_a_session_that_ends_withdraws_its_force(toy):
    stop = threading.Event()
    stop.set()
    toy.loop.run(stop)
    force_n, status = last_of(toy)
    assert force_n == 0.0
    assert (status.code, status.name, status.text) == (
        StatusCode.DISABLED,
        "LATCHED",
        "the session has ended",
    )


@pytest.mark.parametrize("cause", [RuntimeError("a \u00fcnexpected fault"), OverflowError(34, "too large")])
def test_an_unexpected_error_sends_no_force_and_its_cause_and_is_raised_by_who_ended_the_session(
    toy, monkeypatch, cause
):
    def fail(_: LiveLoop) -> None:
        raise cause

    monkeypatch.setattr(LiveLoop, "step", fail)
    thread = SessionThread(toy.loop)
    thread.start()
    thread.join()
    force_n, status = last_of(toy)
    assert force_n == 0.0
    assert status.code == StatusCode.DISABLED
    assert "the session failed" in status.text
    assert type(cause).__name__ in status.text
    assert all(decode(data[:58], data[58:]) for data in map(encode, toy.sent.messages))
    with pytest.raises(type(cause)):
        thread.end()


# ------------------------------------------------------------------ wrong stamps and senders


def restamped(arrivals: list[Arrival], by_s: float, from_s: float, until_s: float = 99.0) -> list[Arrival]:
    """The same, stamped otherwise in a span."""

    def changed(message: Message) -> Message:
        fields = dict(message.fields)
        if "EcgDataTimestamp" in fields:
            fields["EcgDataTimestamp"] = repr(float(fields["EcgDataTimestamp"]) + by_s)
        return replace(message, stamp_s=(message.stamp_s or 0.0) + by_s, fields=MappingProxyType(fields))

    return [a._replace(taken=changed(a.taken)) if from_s <= a.arrived_s < until_s else a for a in arrivals]


def test_a_peer_whose_clock_restarts_comes_back_when_the_operator_re_arms(toy):
    arrivals = restamped(streams_of(24.0), -4000.0, 13.0)
    toy.run(arrivals, 20.0)
    gone = [a for a in toy.answers if 13.5 < a.state.now_s < 14.5]
    assert all(a.state.supervised.hazards & Hazard.CLOCK_BACKWARDS for a in gone)
    assert not np.any([a.state.force_n for a in gone])
    assert states(toy, 18.0, 20.0)[-1] is SupervisorState.LATCHED
    assert not toy.answers[-1].state.supervised.hazards & (Hazard.CLOCK_BACKWARDS | Hazard.STALE_TOOL)
    assert toy.loop.refused > 200
    assert abs(toy.sent.named("ToolForce")[-1].stamp_s - (ORIGIN_S - 4000.0 + 20.0)) < 0.1


@pytest.mark.parametrize("device", ["ToolToTracker", "Image_Tracker", "ProbeToTracker"])
def test_one_stamp_ten_seconds_ahead_disables_nothing(toy, device):
    """In the first second, and while a force is given."""
    arrivals = streams_of(16.0)
    for from_s in (0.3, 13.0):
        later = (i for i, a in enumerate(arrivals) if a.arrived_s > from_s)
        at = next(i for i in later if getattr(arrivals[i].taken, "device", "") == device)
        (arrivals[at],) = restamped([arrivals[at]], 10.0, 0.0)
    toy.run(arrivals, 16.0)
    assert states(toy, 15.0, 16.0)[-1] is SupervisorState.OK
    assert np.linalg.norm(toy.answers[-1].state.force_n) > 0.02


def test_two_programs_that_send_the_tool_fade_and_latch(toy):
    arrivals = streams_of(16.0)
    tools = [a for a in arrivals if isinstance(a.taken, Message) and a.taken.device == "ToolToTracker"]
    other = [a._replace(peer="other", arrived_s=a.arrived_s + 0.003) for a in tools if a.arrived_s > 12.0]
    toy.run(sorted(arrivals + other, key=lambda a: a.arrived_s), 16.0)
    assert SupervisorState.OK in states(toy, 12.5, 13.0)
    assert np.linalg.norm(toy.answers[-1].state.force_n) == 0.0
    assert states(toy, 15.0, 16.0)[-1] is SupervisorState.LATCHED
    assert "other and plus both send the tool" in toy.sent.named("DvfIg")[-1].content.text


def test_what_the_session_refuses_is_counted(toy):
    """Twice the same messages: half of them are of no use."""
    twice = [one for a in streams_of(3.0) for one in (a, a)]
    toy.run(twice, 3.0)
    assert toy.loop.refused > 200
    assert (
        LiveSummary().result(loop_of(toy))["messages_refused"] == toy.loop.refused + toy.loop.source.refused
    )
