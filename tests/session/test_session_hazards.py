"""Each hazard of pose, phase, tracking and time: found in events, and the force goes and comes back."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from toy_session import (
    CENTER,
    GUIDED_S,
    Streams,
    ecg_events,
    ecg_of,
    frame_events,
    guided,
    run,
    ticks,
    tool_events,
    toy_setup,
    toy_streams,
)

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.guidance import (
    HAZARD_RULES,
    FixtureOptions,
    FixtureSet,
    Gaussian,
    Hazard,
    RearmAnswer,
    Sigmoid,
    Status,
    SupervisorState,
)
from dvf_ig.guidance.blend import Blend
from dvf_ig.guidance.supervision.supervisor import FADE_S, FAST_FADE_S, LATCH_AFTER_S
from dvf_ig.session import GuidanceState, Rearm, Session, ToolPose

pytestmark = pytest.mark.usefixtures("known_ultrasound")

OK, DEGRADED, FADE, LATCHED = SupervisorState
FROM_S = 13.0
GUIDING_N = 0.5
Disturbance = Callable[[Streams, float, float], None]


# ------------------------------------------------------------------ disturbances between two times


def _change_tool(change: Callable[[ToolPose], ToolPose | None]) -> Disturbance:
    def disturb(streams: Streams, from_s: float, until_s: float) -> None:
        changed = [change(p) if from_s <= p.t_s < until_s else p for p in streams.tool]
        streams.tool = [p for p in changed if p is not None]

    return disturb


def frozen_tool(streams: Streams, from_s: float, until_s: float) -> None:
    held = next(p for p in streams.tool if p.t_s >= from_s)
    _change_tool(lambda p: ToolPose(p.t_s, held.tracker_from_tool))(streams, from_s, until_s)


def tool_moved_by(matrix: FloatArray) -> Disturbance:
    def moved(p: ToolPose) -> ToolPose:
        assert p.tracker_from_tool is not None
        return ToolPose(p.t_s, matrix @ p.tracker_from_tool)

    return _change_tool(moved)


def swapped_tool(streams: Streams, from_s: float, until_s: float) -> None:
    k = next(k for k, p in enumerate(streams.tool) if p.t_s >= from_s)
    while streams.tool[k].t_s < until_s:
        streams.tool[k : k + 2] = streams.tool[k + 1], streams.tool[k]
        k += 2


def ecg_replaced_by(value: float) -> Disturbance:
    def disturb(streams: Streams, from_s: float, until_s: float) -> None:
        samples = ecg_of(0.0, END_S)
        samples[round(250 * from_s) : round(250 * until_s)] = value
        streams.ecg = ecg_events(samples)

    return disturb


def ecg_silent(streams: Streams, from_s: float, until_s: float) -> None:
    streams.ecg = [e for e in streams.ecg if not from_s <= e.start_s < until_s]


def arrhythmia(streams: Streams, from_s: float, until_s: float) -> None:
    regular = np.arange(0.4, 40.0, 0.8)
    wild = from_s + np.cumsum(np.random.default_rng(3).uniform(0.45, 1.2, 40))
    wild = wild[wild < until_s]
    peaks = np.concatenate([regular[regular < from_s], wild, wild[-1] + 0.8 * np.arange(1, 40)])
    streams.ecg = ecg_events(ecg_of(0.0, END_S, r_peaks=peaks))


def no_images(streams: Streams, from_s: float, until_s: float) -> None:
    streams.frames = [replace(f, image=None) if from_s <= f.t_s < until_s else f for f in streams.frames]


def lost_probe(streams: Streams, from_s: float, until_s: float) -> None:
    streams.frames = [
        replace(f, tracker_from_probe=None) if from_s <= f.t_s < until_s else f for f in streams.frames
    ]


def no_frames(streams: Streams, from_s: float, until_s: float) -> None:
    streams.frames = [f for f in streams.frames if not from_s <= f.t_s < until_s]


def probe_clock_back(streams: Streams, from_s: float, until_s: float) -> None:
    streams.frames = [
        replace(f, t_s=f.t_s - 10.0) if from_s <= f.t_s < until_s else f for f in streams.frames
    ]


def patient_moved(streams: Streams, from_s: float, until_s: float) -> None:
    """And stays there: the pose is found again."""
    streams.frames = frame_events(
        END_S, patient=lambda t_s: np.array([0.0, 0.0, 0.0, 7.0 * (t_s >= from_s), 0.0, 0.0])
    )


def tool_outside(streams: Streams, from_s: float, until_s: float) -> None:
    def at(t_s: float) -> FloatArray:
        far = np.array([60.0 if from_s <= t_s < until_s else 8.0, 0.1 * np.sin(3 * t_s), 0.0])
        return CENTER + far

    streams.tool = tool_events(END_S, at=at)


END_S = 28.0
SHEAR = np.diag([1.01, 1.0, 1.0, 1.0])
lost_tool = _change_tool(lambda p: ToolPose(p.t_s, None))
no_tool_poses = _change_tool(lambda p: None)
tool_clock_back = _change_tool(lambda p: ToolPose(p.t_s - 10.0, p.tracker_from_tool))
nan_tool = _change_tool(lambda p: ToolPose(p.t_s, np.full((4, 4), np.nan)))


def disturbed(disturb: Disturbance, lasting_s: float, until_s: float) -> list[GuidanceState]:
    streams = toy_streams(END_S)
    disturb(streams, FROM_S, FROM_S + lasting_s)
    return guided(streams, until_s)


def sizes(states: list[GuidanceState]) -> FloatArray:
    return np.array([np.linalg.norm(state.force_n) for state in states])


def during(states: list[GuidanceState], hazard: Hazard) -> tuple[float, float]:
    """First and last time at which the hazard was found."""
    found = [state.now_s for state in states if state.supervised.hazards & hazard]
    assert found, f"{hazard.name} was never found"
    return found[0], found[-1]


# ------------------------------------------------------------------ the force goes, and comes back


COMES_BACK = [
    # disturbance, for how long, hazard, found within, force is back so long after the hazard went
    (lost_tool, 0.5, Hazard.TOOL_LOST, 0.026, 0.15),
    (tool_moved_by(SHEAR), 0.5, Hazard.TOOL_LOST, 0.026, 0.15),
    (no_tool_poses, 0.5, Hazard.STALE_TOOL, 0.041, 0.15),
    (frozen_tool, 0.5, Hazard.TOOL_FROZEN, 0.051, 0.15),
    (tool_clock_back, 0.5, Hazard.CLOCK_BACKWARDS, 0.041, 0.15),
    (tool_outside, 1.5, Hazard.OUT_OF_VOLUME, 0.021, 0.2),
    (no_images, 6.0, Hazard.POSE_UNCONFIRMED, 3.6, 0.15),
    (lost_probe, 6.0, Hazard.POSE_UNCONFIRMED, 3.6, 0.15),
    (no_frames, 6.0, Hazard.POSE_UNCONFIRMED, 3.6, 0.15),
    (patient_moved, 6.0, Hazard.POSE_CONTRADICTED, 2.2, 0.15),
]


def _name(value: object) -> str:
    return getattr(value, "__name__", getattr(value, "name", ""))


@pytest.mark.parametrize(("disturb", "lasting_s", "hazard", "within_s", "back_s"), COMES_BACK, ids=_name)
def test_the_force_fades_and_comes_back(
    disturb: Disturbance, lasting_s: float, hazard: Hazard, within_s: float, back_s: float
) -> None:
    states = disturbed(disturb, lasting_s, FROM_S + lasting_s + 8.0)
    times, force = np.array([state.now_s for state in states]), sizes(states)
    before = (times > GUIDED_S + 0.2) & (times < FROM_S - 0.011)
    assert (force[before] > GUIDING_N).all()
    assert {s.supervisor for s, b in zip(states, before, strict=True) if b} == {OK}
    first_s, last_s = during(states, hazard)
    assert FROM_S - 1e-9 <= first_s <= FROM_S + within_s
    assert HAZARD_RULES[hazard].sentence in next(s for s in states if s.now_s == first_s).reasons
    fading = (times >= first_s) & (times <= first_s + FADE_S)
    assert (np.diff(force[fading]) <= 0).all()
    assert {s.supervisor for s, f in zip(states, fading, strict=True) if f} == {FADE}
    withheld = (times > first_s + FADE_S + 0.011) & (times <= last_s)
    assert withheld.any()
    assert not force[withheld].any()
    back = times > last_s + back_s
    assert (force[back] > GUIDING_N).all()
    assert {s.supervisor for s, b in zip(states, back, strict=True) if b} <= {OK, DEGRADED}


LOSES_PHASE = [
    (ecg_replaced_by(0.3), 1.0, 0.22),
    (ecg_replaced_by(np.nan), 1.0, 0.22),
    (ecg_silent, 3.0, 1.3),
    (arrhythmia, 5.0, 3.0),
]


@pytest.mark.parametrize(("disturb", "lasting_s", "within_s"), LOSES_PHASE, ids=_name)
def test_a_lost_phase_leaves_the_wall(disturb: Disturbance, lasting_s: float, within_s: float) -> None:
    """The tool is in the wall; guidance alone, at the same place, fades."""
    states = disturbed(disturb, lasting_s, FROM_S + lasting_s + 1.0)
    times = np.array([state.now_s for state in states])
    first_s, _ = during(states, Hazard.NO_PHASE)
    assert FROM_S - 1e-9 <= first_s <= FROM_S + within_s
    assert HAZARD_RULES[Hazard.NO_PHASE].sentence in next(s for s in states if s.now_s == first_s).reasons
    unknown = [s for s in states if s.status is Status.NO_PHASE and s.now_s < FROM_S + 4.0]
    assert min(sizes(unknown)) > GUIDING_N
    assert {s.supervisor for s in unknown} == {DEGRADED}
    assert all(np.isfinite(s.distance_mm) and s.rate_mm_per_cycle == 0.0 for s in unknown)
    vectors = np.array([s.force_n for s in states])[times > GUIDED_S + 0.2]
    assert np.linalg.norm(np.diff(vectors, axis=0), axis=1).max() < 0.1


@pytest.mark.parametrize("blend", ["force", "periodic"])
def test_a_lost_phase_takes_guidance_away(blend: Blend) -> None:
    """Alone, by the supervisor's fade; next to a wall by the crossing to it, within 250 ms."""
    guide = FixtureOptions(Gaussian(cap_n=0.3), blend)
    for others in ((), (FixtureOptions(Sigmoid(depth_mm=30.0, cap_n=0.3)),)):
        streams = toy_streams(END_S)
        ecg_replaced_by(0.3)(streams, FROM_S, FROM_S + 1.0)
        setup = replace(toy_setup(), fixtures=FixtureSet((guide, *others)))
        with Session(setup) as session:
            states = run(session, streams.merged(), ticks(GUIDED_S, FROM_S + 1.2))
        times, force = np.array([s.now_s for s in states]), sizes(states)
        first_s, last_s = during(states, Hazard.NO_PHASE)
        assert force[times < first_s][-1] > 0.2
        assert force[(times > first_s + FADE_S + 0.011) & (times <= last_s)].max() < 0.001


@pytest.mark.parametrize("disturb", [no_images, lost_probe, no_frames], ids=_name)
def test_a_pose_is_used_for_five_seconds_at_most_when_no_beat_ends(disturb: Disturbance) -> None:
    """Neither ultrasound nor R peaks: the phase is lost first, and the pose has aged when it returns."""

    def both(streams: Streams, from_s: float, until_s: float) -> None:
        disturb(streams, from_s, until_s)
        ecg_silent(streams, from_s, until_s)

    states = disturbed(both, 12.0, 24.0)
    confirmed_s = max(s.now_s - s.pose_age_s for s in states if s.now_s < FROM_S + 1.0)
    first_s, _ = during(states, Hazard.POSE_UNCONFIRMED)
    assert first_s == pytest.approx(confirmed_s + 5.0, abs=0.0101)


# ------------------------------------------------------------------ the force latches


def leaving(t_s: float) -> FloatArray:
    """Inside the ball, out of it from 15 to 17 s, and in again."""
    out = 0.5 * (1 - np.cos(np.pi * min(1.0, max(0.0, min(t_s - 14.5, 17.5 - t_s) / 0.5))))
    return CENTER + np.array([8.0 + 14.0 * out, 0.3 * np.sin(3.0 * t_s), 0.0])


LATCHES = [
    (lost_tool, 1.2, Hazard.TOOL_LOST, FADE_S),
    (no_tool_poses, 1.2, Hazard.STALE_TOOL, FADE_S),
    (frozen_tool, 1.2, Hazard.TOOL_FROZEN, FADE_S),
    (tool_clock_back, 1.2, Hazard.CLOCK_BACKWARDS, FADE_S),
    (probe_clock_back, 1.2, Hazard.CLOCK_BACKWARDS, FADE_S),
    (nan_tool, 0.03, Hazard.NOT_FINITE, FAST_FADE_S),
]


@pytest.mark.parametrize(("disturb", "lasting_s", "hazard", "fade_s"), LATCHES, ids=_name)
def test_the_force_latches_until_it_is_rearmed_outside(
    disturb: Disturbance, lasting_s: float, hazard: Hazard, fade_s: float
) -> None:
    streams = toy_streams(END_S)
    streams.tool = tool_events(END_S, at=leaving)
    disturb(streams, FROM_S, FROM_S + lasting_s)
    refused, accepted = Rearm(14.45), Rearm(16.0)
    streams.others = [refused, accepted]
    states = guided(streams, 19.0)
    times, force = np.array([state.now_s for state in states]), sizes(states)
    first_s, _ = during(states, hazard)
    gone = (times > first_s + fade_s + 0.011) & (times <= 16.0)
    assert not force[gone].any()
    latched_s = next(s.now_s for s in states if s.supervisor is LATCHED)
    at_once = hazard is Hazard.NOT_FINITE
    assert latched_s <= first_s + (FAST_FADE_S if at_once else LATCH_AFTER_S) + 0.021
    held = (times >= latched_s) & (times < 16.0)
    assert {s.supervisor for s, h in zip(states, held, strict=True) if h} == {LATCHED}
    assert all(hazard in s.supervised.cause for s, h in zip(states, held, strict=True) if h)
    assert next(s for s in states if s.now_s == 14.45).rearmed is RearmAnswer.FORCE_WANTED
    assert states[-1].rearmed is RearmAnswer.ACCEPTED
    assert LATCHED not in {s.supervisor for s in states if s.now_s >= 16.0}
    assert (force[times > 17.8] > GUIDING_N).all()


def test_a_latch_stays_without_a_rearm() -> None:
    states = disturbed(lost_tool, 1.2, 20.0)
    assert {s.supervisor for s in states if s.now_s > 14.3} == {LATCHED}
    assert not sizes([s for s in states if s.now_s > 13.3]).any()


# ------------------------------------------------------------------ the force stays


def test_disordered_poses_are_a_warning_that_goes() -> None:
    states = disturbed(swapped_tool, 1.0, 16.0)
    first_s, last_s = during(states, Hazard.REORDERED_STAMPS)
    assert FROM_S < first_s < FROM_S + 0.5
    assert 14.0 < last_s < 15.0
    warned = [s for s in states if first_s <= s.now_s <= last_s]
    assert {s.supervisor for s in warned} == {DEGRADED}
    assert (sizes(warned) > GUIDING_N).all()
    assert states[-1].supervisor is OK


def test_disordered_frames_are_a_warning() -> None:
    streams = toy_streams(20.0)
    for k in range(240, 300, 2):
        streams.frames[k], streams.frames[k + 1] = streams.frames[k + 1], streams.frames[k]
    states = guided(streams, 16.0)
    during(states, Hazard.REORDERED_STAMPS)
    assert (sizes([s for s in states if s.now_s > GUIDED_S + 0.2]) > GUIDING_N).all()


def test_a_pose_update_moves_the_pose_at_a_bounded_speed_and_the_force_slowly() -> None:
    """The patient creeps by 1 mm; every beat moves the pose a little."""
    streams = toy_streams(
        18.0, patient=lambda t_s: np.array([0.0, 0.0, 0.0, min(1.0, max(0.0, t_s - 13.0)), 0.0, 0.0])
    )
    states = guided(streams, 18.0)
    moving = [s for s in states if s.supervised.hazards & Hazard.POSE_MOVING]
    assert moving
    assert {s.supervisor for s in moving if s.now_s > GUIDED_S + 0.2} == {DEGRADED}
    assert (sizes([s for s in states if s.now_s > GUIDED_S + 0.2]) > GUIDING_N).all()
    heart = np.vstack([np.eye(3), -np.eye(3)]) * 40.0 + CENTER
    poses = [s.transform.pose.at(s.now_s) for s in states if s.transform.pose is not None]
    source = poses[0].inverse().apply_array(heart)
    places = np.array([pose.apply_array(source) for pose in poses])
    assert np.linalg.norm(places[-1] - places[0], axis=1).mean() > 0.4
    step_mm = np.linalg.norm(np.diff(places, axis=0), axis=2).mean(axis=1)
    assert step_mm.max() <= 10.0 * 0.01 * (1 + 1e-6)


def test_two_lost_poses_of_the_tool_fade_the_force_and_nothing_jumps() -> None:
    """At 1 kHz: a step is at most the slew limit, 0.1 N, and a fade once begun ends."""
    streams = toy_streams(14.0)
    lost_tool(streams, FROM_S, FROM_S + 0.019)
    with Session(toy_setup()) as session:
        states = run(session, streams.merged(), ticks(12.5, 13.6, 0.001))
    vectors = np.array([s.force_n for s in states])
    assert np.linalg.norm(np.diff(vectors, axis=0), axis=1).max() <= 0.1
    force = sizes(states)
    ended = round(1000 * (FROM_S + 0.016 + FADE_S - 12.5))
    assert force[ended - 1 : ended + 2].min() == 0.0
    assert force[-1] > GUIDING_N


def test_a_device_s_servo_is_published_what_the_session_s_own_is_but_for_the_tracked_tool() -> None:
    """A device's encoders know the tool; pose, phase and margins are the session's."""
    states = disturbed(lost_tool, 0.5, FROM_S + 0.4)
    place = Rigid.identity("tracker", "device")
    known, lost = states[0].inputs(place), states[-1].inputs(place)
    assert states[-1].hazards & Hazard.TOOL_LOST
    assert (known.hazards, lost.hazards) == (Hazard.NONE, Hazard.NONE)
    assert (lost.tool_status, lost.now_s) == (Status.OK, states[-1].now_s)
    assert lost.transform is states[-1].transform
    np.testing.assert_array_equal(lost.margin_mm, states[-1].margin_mm)


def test_breathing_that_nothing_follows_withholds_the_pose_and_is_said() -> None:
    """5 mm from end to end, 15 a minute; a heart that lies still is served on."""

    def breathes(t_s: float) -> np.ndarray:
        return np.array([0.0, 0.0, 0.0, 2.5 * np.sin(2 * np.pi * t_s / 4.0), 0.0, 0.0])

    states = guided(toy_streams(30.0, patient=breathes), 30.0, from_s=29.0)
    assert all(state.hazards & Hazard.BREATHING for state in states)
    assert "ultrasound shows the heart moving by 4." in " ".join(states[-1].reasons)
    assert "that nothing follows: record them (key respiration)" in " ".join(states[-1].reasons)
    assert not any(state.force_n.any() for state in states[-20:])
    calm = guided(toy_streams(30.0), 30.0, from_s=29.0)
    assert not any(state.hazards & Hazard.BREATHING for state in calm)
