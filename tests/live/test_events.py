"""Messages as events: clocks, frames with their poses, the reference marker, orientation, what is refused."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, Rigid
from dvf_ig.live.devices import DeviceNames, flips_between
from dvf_ig.live.events import MOST_CLOCKS, SETTLE_S, EventSource, PeerClock
from dvf_ig.live.frames import WAIT_S, FramePairing
from dvf_ig.live.igtl import (
    Image,
    Message,
    Text,
    TrackedTool,
    TrackingData,
    Transform,
    WireError,
    WireProblem,
)
from dvf_ig.live.link import Arrival
from dvf_ig.live.samples.batches import BatchClock
from dvf_ig.live.samples.field import EcgField
from dvf_ig.live.samples.respiration import BreathField
from dvf_ig.session import EcgSamples, ToolPose, TrackedFrame

ORIGIN_S = 1000.0
NAMES = DeviceNames("ProbeToTracker", "ToolToTracker", "Image_Tracker")
PICTURE = np.arange(16 * 20).astype(np.uint8).reshape(16, 20)


def shifted(x_mm: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 3] = x_mm
    return matrix


def pose(name: str, t_s: float, x_mm: float, **fields: str) -> Message:
    return Message(name, t_s + ORIGIN_S, Transform(shifted(x_mm)), MappingProxyType(fields))


def settled(
    names: DeviceNames = NAMES, ecg: EcgField | None = None, breath: BreathField | None = None
) -> tuple[EventSource, list[str]]:
    """A source whose peer's clock is known: ORIGIN_S ahead."""
    told: list[str] = []
    source = EventSource(names, ecg, told.append, breath)
    for t_s in (0.0, SETTLE_S):
        source.events(Arrival(t_s, "plus", Message("other", t_s + ORIGIN_S, Text(""))))
    return source, told


def events(source: EventSource, *messages: Message | WireError, arrived_s: float = 2.0) -> list[object]:
    return [e.event for m in messages for e in source.events(Arrival(arrived_s, "plus", m))]


# ------------------------------------------------------------------ clocks


def test_offset_is_that_of_the_fastest_message():
    clock = PeerClock()
    for stamp_s, arrived_s in ((10.0, 1.02), (10.1, 1.103), (10.2, 1.25)):
        clock.see(stamp_s, arrived_s)
    assert clock.offset_s == pytest.approx(8.997)
    assert not clock.settled
    clock.see(12.0, 2.03)
    assert clock.settled
    assert clock.offset_s == pytest.approx(8.997)
    assert clock.local_s(12.0, 3.3) == pytest.approx(3.003)
    assert clock.local_s(None, 3.3) == 3.3


def test_first_second_is_held_and_comes_whole():
    source = EventSource(NAMES, None, lambda _: None)
    early = [Arrival(t, "plus", pose("ToolToTracker", t, t)) for t in (0.2, 0.5, 0.9)]
    assert [source.events(one) for one in early] == [[], [], []]
    later = source.events(Arrival(1.3, "plus", pose("ToolToTracker", 1.295, 9.0)))
    assert [round(e.event.t_s, 3) for e in later if isinstance(e.event, ToolPose)] == [0.2, 0.5, 0.9, 1.295]
    assert [e.arrived_s for e in later] == [0.2, 0.5, 0.9, 1.3]


def test_peer_that_stamps_nothing_is_stamped_by_arrival():
    source = EventSource(NAMES, None, lambda _: None)
    message = Message("ToolToTracker", None, Transform(np.eye(4)))
    (event,) = source.events(Arrival(7.5, "slicer", message))
    assert isinstance(event.event, ToolPose)
    assert event.event.t_s == 7.5
    assert source.tool_offset_s == 0.0


# ------------------------------------------------------------------ poses


def test_poses_of_transform_and_tracking_data():
    source, _ = settled()
    tools = TrackingData(
        (TrackedTool("ToolToTracker", shifted(5.0)), TrackedTool("ProbeToTracker", shifted(6.0)))
    )
    (tool,) = events(source, Message("TDATA_2Elem", 2.0 + ORIGIN_S, tools))
    assert isinstance(tool, ToolPose)
    assert tool.tracker_from_tool is not None
    assert tool.tracker_from_tool[0, 3] == 5.0
    lost = Message("x", 2.1 + ORIGIN_S, tools, MappingProxyType({"ToolToTrackerStatus": "OUT_OF_VIEW"}))
    (tool,) = events(source, lost)
    assert isinstance(tool, ToolPose)
    assert tool.tracker_from_tool is None


def test_long_names_are_known_by_what_fits():
    names = DeviceNames("UltrasoundProbeToReferenceMarker", "ToolToTracker", "Image_Tracker")
    source, _ = settled(names)
    long = pose("UltrasoundProbeToRef", 2.0, 1.0, IGTL_DEVICE_NAME="UltrasoundProbeToReferenceMarker")
    image = Message("Image_Tracker", 2.0 + ORIGIN_S, Image(PICTURE[None], np.eye(4)))
    (frame,) = events(source, long, image)
    assert isinstance(frame, TrackedFrame)
    assert frame.tracker_from_probe is not None


def test_poses_against_a_reference_marker():
    names = DeviceNames("ProbeToTracker", "ToolToTracker", "Image_Tracker", "ReferenceToTracker")
    source, _ = settled(names)
    turned = Rigid.from_rotation_vector(
        [0.0, 0.0, np.pi / 2], [10.0, 0.0, 0.0], "tracker", "reference"
    ).matrix
    assert events(source, pose("ToolToTracker", 1.9, 12.0))[0].tracker_from_tool is None  # type: ignore[attr-defined]
    reference = Message("ReferenceToTracker", 2.0 + ORIGIN_S, Transform(turned))
    assert events(source, reference) == []
    (tool,) = events(source, pose("ToolToTracker", 2.0, 12.0))
    assert isinstance(tool, ToolPose)
    assert tool.tracker_from_tool is not None
    np.testing.assert_allclose(tool.tracker_from_tool[:3, 3], (0.0, -2.0, 0.0), atol=1e-12)
    (late,) = events(source, pose("ToolToTracker", 2.2, 12.0))
    assert isinstance(late, ToolPose)
    assert late.tracker_from_tool is None


def test_pose_that_is_not_finite_reaches_the_session():
    source, told = settled()
    for problem, is_none in ((WireProblem.NOT_FINITE, False), (WireProblem.NOT_RIGID, True)):
        (tool,) = events(source, WireError(problem, "TRANSFORM", "ToolToTracker", 2.0 + ORIGIN_S))
        assert isinstance(tool, ToolPose)
        assert (tool.tracker_from_tool is None) is is_none
    assert events(source, WireError(WireProblem.CHECKSUM, "TRANSFORM", "ToolToTracker", 2.0)) == []
    assert source.refused == 3
    assert len(told) == 3


# ------------------------------------------------------------------ frames


def test_image_waits_for_the_pose_of_its_stamp():
    frames = FramePairing()
    assert frames.add_image(2.0, PICTURE, 2.01) == []
    assert frames.add_pose(1.9, shifted(1.0)) == []
    (frame,) = frames.add_pose(2.0 + 1e-7, shifted(2.0))
    assert frame.tracker_from_probe is not None
    assert (frame.t_s, frame.tracker_from_probe[0, 3]) == (2.0, 2.0)
    (frame,) = frames.add_pose(2.1, None) + frames.add_image(2.1, PICTURE, 2.11)
    assert frame.tracker_from_probe is None


def test_pose_between_two_stamps_is_interpolated_unless_stamps_are_shared():
    frames = FramePairing()
    frames.add_pose(2.0, shifted(1.0))
    frames.add_image(2.03, PICTURE, 2.04)
    (frame,) = frames.add_pose(2.1, shifted(2.0))
    assert frame.tracker_from_probe is not None
    assert frame.tracker_from_probe[0, 3] == pytest.approx(1.3)
    (_,) = frames.add_image(2.1, PICTURE, 2.11)  # from now on stamps are shared
    frames.add_image(2.15, PICTURE, 2.16)
    (frame,) = frames.add_pose(2.2, shifted(3.0))
    assert frame.tracker_from_probe is None


def test_image_whose_pose_never_comes_has_none():
    frames = FramePairing()
    frames.add_image(2.0, PICTURE, 2.01)
    assert frames.overdue(2.01 + WAIT_S / 2) == []
    (frame,) = frames.overdue(2.02 + WAIT_S)
    assert frame.tracker_from_probe is None


@pytest.mark.parametrize(
    ("sent", "expected"),
    [("MF", PICTURE), ("UF", PICTURE[:, ::-1]), ("MN", PICTURE[::-1]), ("UN", PICTURE[::-1, ::-1])],
)
def test_images_are_turned_as_the_probe_was_calibrated(sent, expected):
    names = DeviceNames("P", "T", "Image_Tracker", flips=flips_between(sent, "MF"))
    found = names.image_of(Message("Image_Tracker", 1.0, Image(PICTURE[None], np.eye(4))))
    np.testing.assert_array_equal(found, expected)


def test_image_of_colours_is_refused_with_what_to_do():
    colours = Image(np.zeros((1, 3, 4, 3), np.uint8), np.eye(4))
    with pytest.raises(InvalidInputError, match="US_IMG_BRIGHTNESS"):
        NAMES.image_of(Message("Image_Tracker", 1.0, colours))


# ------------------------------------------------------------------ breathing


def test_a_marker_on_the_chest_is_breathing_and_one_that_is_not_seen_is_a_gap():
    source, _ = settled(replace(NAMES, chest="ChestToTracker", reference="ReferenceToTracker"))
    assert events(source, pose("ChestToTracker", 1.9, 12.0)) == []
    seen = events(source, pose("ReferenceToTracker", 2.0, 10.0), pose("ChestToTracker", 2.0, 12.0))
    assert [(e.t_s, e.values.tolist()) for e in seen] == [(2.0, [2.0, 0.0, 0.0])]  # type: ignore[attr-defined]
    assert events(source, pose("ChestToTracker", 2.05, 12.0, TransformStatus="MISSING")) == []
    wrong = WireError(WireProblem.NOT_FINITE, "TRANSFORM", "ChestToTracker", 2.1 + ORIGIN_S)
    assert events(source, wrong) == []


def test_a_field_of_breathing_is_stamped_as_its_message_or_as_it_states():
    source, told = settled(breath=BreathField("Icu"))
    fields = MappingProxyType({"IcuLeads": "ABP Paw"})
    found = events(source, Message("Icu", 2.0 + ORIGIN_S, Text("90 5.5"), fields))
    assert [(e.t_s, e.values.tolist()) for e in found] == [(2.0, [5.5])]  # type: ignore[attr-defined]
    assert events(source, Message("Icu", 2.1 + ORIGIN_S, Text("90 5.5 91 6"), fields)) == []
    assert "live.respiration.rate_hz" in told[0]
    source, told = settled(breath=BreathField("Icu", 10.0))
    several = Message("Icu", 2.2 + ORIGIN_S, Text("1 nan 3"))
    assert [round(e.t_s, 6) for e in events(source, several)] == [2.0, 2.2]  # type: ignore[attr-defined]
    stated = MappingProxyType({"IcuTimestamp": repr(2.25 + ORIGIN_S)})
    late = Message("Icu", 2.6 + ORIGIN_S, Text("1 2"), stated)
    assert [round(e.t_s, 6) for e in events(source, late)] == [2.25, 2.35]  # type: ignore[attr-defined]
    doubtful = MappingProxyType({"IcuLeads": "Paw Flow"})
    assert events(source, Message("Icu", 3.0 + ORIGIN_S, Text("1 2"), doubtful)) == []
    assert "of which one must be breathing; name it as live.respiration.channel" in told[0]


# ------------------------------------------------------------------ ECG


def test_ecg_is_where_its_time_says():
    source, _ = settled(ecg=EcgField("EcgData", 500.0))
    fields = MappingProxyType({"EcgDataTimestamp": "1001.98", "EcgDataLeads": "I II"})
    message = Message("EcgData", 2.0 + ORIGIN_S, Text("1 2 3 4 nan inf"), fields)
    (batch,) = events(source, message)
    assert isinstance(batch, EcgSamples)
    assert batch.start_s == pytest.approx(1.98)
    np.testing.assert_array_equal(batch.samples, [[1, 2], [3, 4], [np.nan, np.nan]])
    assert events(source, message) == []


@pytest.mark.parametrize(
    ("leads", "lead", "expected"),
    [("II Pleth", None, [[1], [3]]), ("II Pleth", "pleth", [[2], [4]]), ("one two", None, [[1, 2], [3, 4]])],
)
def test_a_field_with_other_channels_is_used_without_them(leads, lead, expected):
    source, _ = settled(ecg=EcgField("EcgData", 500.0, lead))
    fields = MappingProxyType({"EcgDataLeads": leads})
    (batch,) = events(source, Message("EcgData", 2.0 + ORIGIN_S, Text("1 2 3 4"), fields))
    assert isinstance(batch, EcgSamples)
    np.testing.assert_array_equal(batch.samples, expected)


def test_a_field_without_an_ecg_is_refused_by_name():
    source, told = settled(ecg=EcgField("EcgData", 500.0))
    fields = MappingProxyType({"EcgDataLeads": "ABP Resp"})
    assert events(source, Message("EcgData", 2.0 + ORIGIN_S, Text("1 2 3 4"), fields)) == []
    assert "the field EcgData has no channel of an ECG, only ABP, Resp" in told[0]


def test_ecg_beside_an_image_is_read():
    source, _ = settled(ecg=EcgField("EcgData", 500.0))
    image = Message(
        "Image_Tracker",
        2.0 + ORIGIN_S,
        Image(PICTURE[None], np.eye(4)),
        MappingProxyType({"EcgData": "1,2,3"}),
    )
    batch, frame = events(source, image, pose("ProbeToTracker", 2.0, 1.0))
    assert isinstance(batch, EcgSamples)
    assert batch.start_s == pytest.approx(2.0 - 2 / 500.0)
    assert isinstance(frame, TrackedFrame)


@pytest.mark.parametrize("text", ["a b", "1 2 x", "1 2 3"])
def test_ecg_that_is_none_is_refused(text):
    source, told = settled(ecg=EcgField("EcgData", 500.0))
    fields = MappingProxyType({"EcgDataLeads": "I II"})
    assert events(source, Message("EcgData", 2.0 + ORIGIN_S, Text(text), fields)) == []
    assert len(told) == 1


def test_batches_are_even_whatever_their_delays():
    """Counting from the fastest batch: errors are below the least delay, and samples do not overlap."""
    clock, delays = BatchClock(500.0), np.random.default_rng(3).uniform(0.002, 0.03, 200).tolist()
    first = [clock.first_s(10, (10 * k + 9) / 500.0 + delay) for k, delay in enumerate(delays)]
    errors = np.array(first[20:]) - np.arange(20, 200) * 0.02
    assert errors.min() > 0.0
    assert errors.max() < 0.006
    gap = clock.first_s(10, (10 * 260 + 9) / 500.0 + 0.002)
    assert gap == pytest.approx(5.2, abs=0.01)


# ------------------------------------------------------------------ wrong stamps and senders


def test_a_stamp_far_ahead_in_the_first_second_is_no_offset():
    clock = PeerClock()
    for stamp_s, arrived_s in ((20.0, 1.0), (10.1, 1.103), (10.2, 1.25), (10.3, 1.31)):
        clock.see(stamp_s, arrived_s)
    assert clock.offset_s == pytest.approx(8.997)
    clock.see(12.0, 2.03)
    assert clock.settled
    assert clock.offset_s == pytest.approx(8.997)


@pytest.mark.parametrize("stamp_s", [2.0**32 - 1.0, 4.1e9])
def test_a_stamp_that_leaves_no_room_for_answers_is_refused(stamp_s):
    """Of any message, also in a peer's first second, and it does not move the peer's clock."""
    told: list[str] = []
    source = EventSource(NAMES, None, told.append)
    late = Message("ToolToTracker", stamp_s, Transform(np.eye(4)))
    assert source.events(Arrival(0.0, "plus", late)) == []
    assert source.events(Arrival(0.1, "plus", pose("ToolToTracker", 0.1, 1.0))) == []
    found = source.events(Arrival(1.2, "plus", pose("ToolToTracker", 1.2, 1.0)))
    assert [round(e.event.t_s, 3) for e in found if isinstance(e.event, ToolPose)] == [0.1, 1.2]
    assert (source.refused, len(told)) == (1, 1)
    assert "set the sender's clock" in told[0]


def test_a_pose_that_is_exactly_the_identity_is_lost_and_named():
    told: list[str] = []
    source = EventSource(NAMES, None, told.append)
    poses = [pose("ToolToTracker", t_s, x_mm) for t_s, x_mm in ((0.1, 1.0), (0.2, 0.0), (1.2, 1.0))]
    found = [event for one in poses for event in source.events(Arrival(0.0, "plus", one))]
    found += source.events(Arrival(1.3, "plus", pose("ToolToTracker", 1.3, 1.0)))
    tracked = [one.event.tracker_from_tool is not None for one in found if isinstance(one.event, ToolPose)]
    assert tracked == [True, False, True, True]
    assert told == [
        "a pose of the tool is exactly the identity, as programs send it for a marker that they do not see; "
        "it counts as lost"
    ]


def sent_by(source: EventSource, peer: str, arrived_s: float) -> list[ToolPose]:
    message = Message("ToolToTracker", None, Transform(shifted(1.0)))
    found = source.events(Arrival(arrived_s, peer, message))
    return [e.event for e in found if isinstance(e.event, ToolPose)]


def test_two_programs_that_send_the_tool_lose_it_until_one_ends():
    source = EventSource(NAMES, None, lambda _: None)
    assert sent_by(source, "a", 0.00)[0].tracker_from_tool is not None
    assert sent_by(source, "b", 0.01)[0].tracker_from_tool is not None, "it may take over"
    for t_s in (0.02, 0.04, 0.06):
        assert sent_by(source, "a", t_s)[0].tracker_from_tool is None
        assert sent_by(source, "b", t_s + 0.01)[0].tracker_from_tool is None
    problem = source.problem(0.1)
    assert problem is not None
    assert "a and b both send the tool" in problem
    assert sent_by(source, "b", 1.2)[0].tracker_from_tool is not None
    assert source.problem(1.2) is None


def test_a_program_that_takes_over_the_tool_is_no_second_sender():
    source = EventSource(NAMES, None, lambda _: None)
    for k in range(50):
        assert sent_by(source, "before" if k < 25 else "after", 0.01 * k)[0].tracker_from_tool is not None
    assert source.problem(0.5) is None


def test_clocks_of_peers_that_went_are_forgotten():
    source = EventSource(NAMES, None, lambda _: None)
    for k in range(10 * MOST_CLOCKS):
        sent_by(source, f"127.0.0.1:{k}", 0.1 * k)
    assert len(source._clocks) == MOST_CLOCKS


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 480, 8)])
def test_an_image_that_shows_nothing_is_refused(shape):
    with pytest.raises(InvalidInputError, match="needed 16 x 16 or more"):
        NAMES.image_of(Message("Image_Tracker", 1.0, Image(np.zeros(shape, np.uint8), np.eye(4))))


def test_a_pose_far_ahead_does_not_bend_those_between_others():
    frames = FramePairing()
    frames.add_pose(2.0, shifted(1.0))
    frames.add_pose(12.0, shifted(99.0))
    frames.add_pose(2.1, shifted(2.0))
    (frame,) = frames.add_image(2.03, PICTURE, 2.04)
    assert frame.tracker_from_probe is not None
    assert frame.tracker_from_probe[0, 3] == pytest.approx(1.3)


def test_samples_that_no_ecg_has_are_missing_and_a_batch_of_minutes_is_refused():
    source, told = settled(ecg=EcgField("EcgData", 500.0))
    (batch,) = events(source, Message("EcgData", 2.0 + ORIGIN_S, Text("0.1 1e200 -1e10 0.2")))
    assert isinstance(batch, EcgSamples)
    np.testing.assert_array_equal(batch.samples[:, 0], [0.1, np.nan, np.nan, 0.2])
    assert events(source, Message("EcgData", 2.1 + ORIGIN_S, Text("0 " * 2501))) == []
    assert "check its rate" in told[0]
