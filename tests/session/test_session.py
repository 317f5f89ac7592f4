"""Events give the same bits however they come; a state knows nothing later; misuse is one line."""

from collections import deque
from collections.abc import Sequence
from itertools import takewhile

import numpy as np
import pytest
from toy_session import (
    GUIDED_S,
    HOME,
    Streams,
    bits,
    compare_known,
    ecg_events,
    ecg_of,
    guided,
    register_known,
    run,
    stamp,
    ticks,
    toy_setup,
    toy_streams,
)

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.session import (
    EcgSamples,
    Event,
    GuidanceState,
    Landmark,
    Rearm,
    Session,
    ThreadedExecutor,
    ToolPose,
    TrackedFrame,
)

pytestmark = pytest.mark.usefixtures("known_ultrasound")

END_S = 17.0
TIMES = ticks(GUIDED_S, END_S, 0.02)


def shifting(t_s: float) -> FloatArray:
    return np.array([0.0, 0.0, 0.0, 0.4 * min(1.0, max(0.0, t_s - 12.0)), 0.0, 0.0])


def eventful(chunk: int = 50) -> Streams:
    """A patient who moves a little, a tool that is lost and latches, disorder, an operator who re-arms."""
    streams = toy_streams(END_S, patient=shifting, chunk=chunk)
    for k in range(1300, 1420):
        streams.tool[k] = ToolPose(streams.tool[k].t_s, None)
    for k in range(1450, 1500, 2):
        streams.tool[k], streams.tool[k + 1] = streams.tool[k + 1], streams.tool[k]
    streams.others = [
        Landmark(14.0, "apex", HOME.apply_array(np.array([[1.0, 2.0, 3.0]]))[0], np.array([1.0, 2.0, 3.0])),
        Rearm(14.6),
        Rearm(16.0),
    ]
    return streams


def all_bits(states: Sequence[GuidanceState]) -> list[tuple[object, ...]]:
    return [bits(state) for state in states]


@pytest.fixture(scope="module")
def reference() -> list[tuple[object, ...]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
        patch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
        with Session(toy_setup()) as session:
            states = run(session, eventful().merged(), TIMES)
    assert any(state.force_n.any() for state in states)
    assert {state.supervisor for state in states} == set(SupervisorState)
    assert any(state.supervised.hazards & Hazard.REORDERED_STAMPS for state in states)
    return all_bits(states)


@pytest.mark.parametrize("chunk", [1, 1000])
def test_how_the_ecg_is_cut_changes_nothing(reference: list[tuple[object, ...]], chunk: int) -> None:
    with Session(toy_setup()) as session:
        assert all_bits(run(session, eventful(chunk).merged(), TIMES)) == reference


def test_events_that_come_all_at_once_change_nothing(reference: list[tuple[object, ...]]) -> None:
    streams = eventful()
    with Session(toy_setup()) as session:
        for event in [*streams.others, *streams.tool, *streams.frames, *streams.ecg]:
            session.push(event)
        assert all_bits([session.state(t_s) for t_s in TIMES]) == reference


@pytest.mark.parametrize("seed", range(2))
def test_how_the_streams_are_interleaved_changes_nothing(
    reference: list[tuple[object, ...]], seed: int
) -> None:
    """Each stream runs ahead of what is asked for by a time of its own that changes."""
    rng = np.random.default_rng(seed)
    s = eventful(int(rng.integers(1, 200)))
    landmarks = [e for e in s.others if isinstance(e, Landmark)]
    rearms = [e for e in s.others if isinstance(e, Rearm)]
    queues: list[list[Event]] = [list(q) for q in (s.ecg, s.frames, s.tool, landmarks, rearms)]
    states = []
    with Session(toy_setup()) as session:
        for now_s in TIMES:
            for k in rng.permutation(len(queues)):
                ahead_s = float(rng.choice([0.0, 0.1, 3.0]))
                while queues[k] and stamp(queues[k][0]) <= now_s + ahead_s:
                    session.push(queues[k].pop(0))
            states.append(session.state(now_s))
    assert all_bits(states) == reference


def test_threads_that_are_waited_for_change_nothing(reference: list[tuple[object, ...]]) -> None:
    with ThreadedExecutor(waits=True) as executor, Session(toy_setup(), executor=executor) as session:
        assert all_bits(run(session, eventful().merged(), TIMES)) == reference


def test_states_that_are_asked_for_more_often_change_no_estimate() -> None:
    """Pose and phase are the same bits; the servo's ticks are those of other times."""
    streams = toy_streams(14.5, patient=shifting)
    coarse = guided(streams, 14.5)
    with Session(toy_setup()) as session:
        fine = run(session, streams.merged(), ticks(0.0, 14.5, 0.005))
    known = {state.now_s: state for state in fine}
    for state in coarse:
        other = known[state.now_s]
        assert state.transform.packed.tobytes() == other.transform.packed.tobytes()
        np.testing.assert_allclose(state.wanted_n, other.wanted_n, atol=1e-3)
        assert state.pose_age_s == other.pose_age_s


@pytest.mark.parametrize("cut_s", [12.9, 13.61, 14.52, 15.3])
def test_a_state_depends_on_nothing_that_is_stamped_later(
    reference: list[tuple[object, ...]], cut_s: float
) -> None:
    """Cut anywhere, and go on with quite another intervention."""
    other = toy_streams(END_S, patient=lambda t_s: np.array([0.0, 0.0, 0.0, -3.0, 0.0, 0.0]))
    other.ecg = ecg_events(0.5 * ecg_of(0.0, END_S, r_peaks=np.arange(0.3, 20.0, 0.55)), chunk=1)
    streams = eventful(chunk=1)
    for name in ("ecg", "frames", "tool"):
        kept = list(takewhile(lambda e: stamp(e) <= cut_s, getattr(streams, name)))
        changed = [e for e in getattr(other, name) if stamp(e) > cut_s]
        if name == "tool":
            changed = [ToolPose(e.t_s, None) for e in changed]
        setattr(streams, name, kept + changed)
    streams.others = [e for e in streams.others if stamp(e) <= cut_s]
    before = [t_s for t_s in TIMES if t_s <= cut_s]
    with Session(toy_setup()) as session:
        for event in [*streams.frames, *streams.ecg, *streams.tool, *streams.others]:
            session.push(event)
        assert all_bits([session.state(t_s) for t_s in before]) == reference[: len(before)]


def test_events_of_the_first_half_minute_are_kept_until_they_are_asked_for() -> None:
    """All at once, more than twenty seconds ahead."""
    streams, times = toy_streams(31.0), ticks(GUIDED_S, 31.0, 0.25)
    with Session(toy_setup()) as session:
        expected = all_bits(run(session, streams.merged(), times))
    with Session(toy_setup()) as session:
        for event in [*streams.frames, *streams.tool, *streams.ecg]:
            session.push(event)
        assert all_bits([session.state(t_s) for t_s in times]) == expected


def test_events_that_come_late_count_from_then_on() -> None:
    """As from a live link: each chunk of the ECG 0.2 s after its first sample, frames 80 ms late."""
    streams = toy_streams(15.0)
    arrivals: list[tuple[float, Event]] = [(e.start_s + 0.2, e) for e in streams.ecg]
    arrivals += [(f.t_s + 0.08, f) for f in streams.frames]
    arrivals += [(p.t_s + 0.004, p) for p in streams.tool]
    arrivals.sort(key=lambda arrival: arrival[0])
    with Session(toy_setup()) as session:
        states = []
        for now_s in ticks(0.0, 15.0):
            while arrivals and arrivals[0][0] <= now_s:
                session.push(arrivals.pop(0)[1])
            states.append(session.state(now_s))
    guiding = [state for state in states if state.now_s > GUIDED_S]
    assert {state.supervisor for state in guiding} <= {SupervisorState.OK, SupervisorState.DEGRADED}
    assert all(np.linalg.norm(state.force_n) > 0.5 for state in guiding)


def test_a_late_ecg_moves_the_pose_no_faster() -> None:
    """A beat that is known late updates the pose from then on, not from when it could have been known."""
    streams = toy_streams(20.0, patient=lambda t_s: np.array([0, 0, 0, 0.8 * max(0.0, t_s - 12.0), 0, 0]))
    arrivals: list[tuple[float, Event]] = [(e.start_s + 0.6, e) for e in streams.ecg]
    arrivals += [(f.t_s, f) for f in streams.frames] + [(p.t_s, p) for p in streams.tool]
    arrivals.sort(key=lambda arrival: arrival[0])
    places = []
    with Session(toy_setup()) as session:
        for now_s in ticks(0.0, 20.0):
            while arrivals and arrivals[0][0] <= now_s:
                session.push(arrivals.pop(0)[1])
            pose = session.state(now_s).transform.pose
            if pose is not None:
                places.append(pose.at(now_s).apply_array(HOME.inverse().apply_array(np.zeros((1, 3))))[0])
    step_mm = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert step_mm.sum() > 0.3
    assert step_mm.max() <= 10.0 * 0.01 * (1 + 1e-6)


def test_an_ecg_gap_is_known_when_it_ends() -> None:
    """Whether the samples after it have been pushed already or not."""
    streams, times = toy_streams(15.0), ticks(GUIDED_S, 15.0)
    streams.ecg = [e for e in streams.ecg if not 13.0 <= e.start_s < 13.6]
    with Session(toy_setup()) as session:
        late = all_bits(run(session, streams.merged(), times))
    with Session(toy_setup()) as session:
        for event in [*streams.ecg, *streams.frames, *streams.tool]:
            session.push(event)
        assert all_bits([session.state(t_s) for t_s in times]) == late


# ------------------------------------------------------------------ before anything is known


def test_without_any_event_there_is_no_force() -> None:
    with Session(toy_setup()) as session:
        state = session.state(0.0)
    assert state.supervisor is SupervisorState.FADE
    assert not state.force_n.any()
    assert state.status is Status.NO_POSE
    assert state.estimate is None
    assert state.registration is None
    assert state.pose_age_s == np.inf
    assert state.supervised.hazards == Hazard.TOOL_LOST | Hazard.NO_POSE | Hazard.NO_PHASE
    assert len(state.reasons) == 3


def test_without_a_start_or_landmarks_nothing_is_registered_and_landmarks_start_it() -> None:
    streams = toy_streams(19.0)
    with Session(toy_setup(start=None)) as session:
        states = run(session, streams.merged(), ticks(12.0, 18.9, 0.1))
    assert all(state.estimate is None and state.registration is None for state in states)
    touched = np.array([[30.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, 30.0]])
    streams.others = [
        Landmark(8.5 + k, f"point {k}", HOME.apply_array(p[None])[0], p) for k, p in enumerate(touched)
    ]
    with Session(toy_setup(start=None)) as session:
        states = run(session, streams.merged(), ticks(12.0, 18.9, 0.1))
    assert states[-1].estimate is not None
    assert states[-1].supervisor is SupervisorState.OK


# ------------------------------------------------------------------ misuse


def test_time_that_goes_back_or_is_no_number_is_refused() -> None:
    with Session(toy_setup()) as session:
        session.state(1.0)
        session.state(1.0)
        for wrong in (0.999, float("nan"), float("inf")):
            with pytest.raises(InvalidInputError, match=r"asked for after that at 1 s; ask in order of time"):
                session.state(wrong)
        session.state(1.001)


def test_a_refused_event_changes_nothing() -> None:
    """Another image size, another number of leads: one sentence each; an ECG that goes back is dropped."""
    streams = toy_streams(13.0)
    times = ticks(GUIDED_S, 13.0)
    with Session(toy_setup()) as session:
        expected = all_bits(run(session, streams.merged(), times))
    with Session(toy_setup()) as session:
        for event in streams.merged():
            session.push(event)
        image = np.zeros((24, 25), dtype=np.uint8)
        with pytest.raises(InvalidInputError, match=r"\(24, 25\) pixels, those before \(24, 24\)"):
            session.push(TrackedFrame(13.0, image, np.eye(4)))
        with pytest.raises(InvalidInputError, match=r"shape \(5, 2\); needed \(n, 1\)"):
            session.push(EcgSamples(13.0, np.zeros((5, 2))))
        session.push(EcgSamples(12.0, np.zeros((5, 1))))
        assert all_bits([session.state(t_s) for t_s in times]) == expected


def test_an_empty_chunk_of_the_ecg_says_nothing() -> None:
    streams = toy_streams(13.0)
    expected = all_bits(guided(streams, 13.0))
    streams.ecg = [part for e in streams.ecg for part in (EcgSamples(e.start_s, np.zeros((0, 1))), e)]
    assert all_bits(guided(streams, 13.0)) == expected


# ------------------------------------------------------------------ memory


def held(value: object, seen: set[int]) -> int:
    """Elements of all containers that can be reached from a value of ours, except bounded ones."""
    if id(value) in seen or getattr(value, "maxlen", None) is not None:
        return 0
    seen.add(id(value))
    if isinstance(value, dict):
        return len(value) + sum(held(one, seen) for one in value.values())
    if isinstance(value, list | tuple | deque | set):
        return len(value) + sum(held(one, seen) for one in value)
    if not type(value).__module__.startswith("dvf_ig"):
        return 0
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    values = [getattr(value, name, None) for name in slots] + list(getattr(value, "__dict__", {}).values())
    return sum(held(one, seen) for one in values)


@pytest.mark.parametrize("missing", [None, "ecg", "frames", "tool"])
def test_a_session_holds_no_more_after_80_s_than_after_40(missing: str | None) -> None:
    """Nothing is kept for a beat, a frame or a tool that never comes either; 40 s have 50 beats."""
    streams = toy_streams(80.0)
    if missing is not None:
        setattr(streams, missing, [])
    sizes = []
    with Session(toy_setup()) as session:
        for until_s in (40.0, 80.0):
            between = [e for e in streams.merged() if until_s - 40.0 <= stamp(e) < until_s]
            run(session, between, ticks(until_s - 40.0, until_s, 0.1))
            sizes.append(held(session, {id(session.history)}))
    assert sizes[1] - sizes[0] < 30
