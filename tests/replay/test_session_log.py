"""A log read back: by the decoder of another package for ROS tools, and by ours to the last bit."""

import json
import struct
import tracemalloc
from dataclasses import replace
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_ball import ball_model
from toy_run import (
    FIRST,
    FORCE,
    LATER,
    PROBE_FROM_IMAGE,
    TIP,
    TIP_MR,
    pose_at,
    recorded,
    run_folder,
    ticks_csv,
)

from dvf_ig.core import (
    CycleTiming,
    Fan,
    InvalidInputError,
    OutputError,
    Points,
    Preop,
    Respiration,
    Scenario,
    SurfaceSeries,
    TriggerTimes,
    UnreadableFileError,
    VolumeSeries,
)
from dvf_ig.intake.session_log.document import EXACT_TOOL
from dvf_ig.intake.session_log.read import read_session_log
from dvf_ig.replay.events import events_of
from dvf_ig.replay.export.session_log import write_session_log

pytest.importorskip("mcap", reason="session logs need mcap")
pytest.importorskip("rosbags", reason="session logs need rosbags")


def awkward() -> Scenario:
    """Numbers that metres, quaternions and nanoseconds cannot hold, and poses that are not valid."""
    scenario = recorded()
    rng = np.random.default_rng(5)
    tool, ultrasound, preop = scenario.tool, scenario.ultrasound, scenario.preop
    assert tool is not None
    assert preop.mr is not None
    shifts = rng.normal(size=(10, 3)) * 100
    valid = np.arange(10) != 4
    shaken = np.sort(rng.uniform(0, 1, 10))
    probe = replace(ultrasound.poses["tracker_from_probe"], translations_mm=shifts, valid=valid, t_s=shaken)
    samples = rng.normal(size=(173, 2))
    samples[17, 1] = np.nan
    labels = VolumeSeries(preop.mr.grid, (preop.mr.values % 3).astype(np.uint8), preop.mr.timing)
    surface = SurfaceSeries(
        "EPICARDIAL",
        "mr",
        rng.normal(size=(3, 6, 3)) * 40,
        np.array([[0, 1, 2], [3, 4, 5]]),
        CycleTiming(np.array([0.0, 0.31, 0.62]), 0.8123456789),
        "ball",
        np.array([False, True]),
    )
    return replace(
        scenario,
        ecg=replace(scenario.ecg, samples=samples, leads=("II", "V1"), rate_hz=333.3, start_s=0.1 + 0.2),
        ultrasound=replace(ultrasound, t_s=shaken, poses={probe.name: probe}, orientation="MF"),
        tool=replace(tool, translations_mm=shifts / 3, rotations=Rotation.random(10, rng=rng).as_matrix()),
        tip=Points("tool", rng.normal(size=(1, 3)) * 90),
        fan=Fan(rng.uniform(0, 10, 2), 3.3, 15.7, 0.61),
        start=FIRST,
        touched=Points("tracker", rng.normal(size=(4, 3))),
        touched_phase=0.3,
        respiration=Respiration(shaken + 0.01, rng.normal(size=(10, 3)) * 30, "chest"),
        preop=Preop(
            "ball",
            mr=preop.mr,
            labels=labels,
            label_names=((1, "lv_blood"),),
            organ_labels=(1, 2),
            cavity_labels=(1,),
            surfaces=(surface,),
        ),
    )


def logged(folder: Path, scenario: Scenario, name: str = "log.mcap", **options: Any) -> Path:
    run = run_folder()
    (folder / "result.json").write_text(json.dumps({"estimates": {}}))
    (folder / "ticks.csv").write_text(ticks_csv())
    image = PROBE_FROM_IMAGE.matrix.tolist()
    run = replace(run, scenario=scenario, result={"estimates": {"probe_from_image": image}})
    write_session_log(run, folder, folder / name, **options)
    return folder / name


def same(one: Any, other: Any) -> bool:
    """Every field equal to the last bit."""
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(
            same(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__
        )
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return bool(one == other)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = replace(recorded(), tip=Points("tool", TIP))
    return logged(tmp_path_factory.mktemp("log"), scenario, given=ball_model())


@pytest.mark.parametrize("with_model", [False, True])
def test_the_events_are_those_that_were_recorded(tmp_path: Path, with_model: bool) -> None:
    scenario = awkward()
    back = read_session_log(logged(tmp_path, scenario, given=ball_model() if with_model else None))
    for one, other in zip_longest(events_of(scenario), events_of(back.scenario)):
        assert same(one, other)
    for name in ("preop", "fan", "probe", "latency", "tip", "start", "touched", "touched_phase", "ecg"):
        assert same(getattr(scenario, name), getattr(back.scenario, name)), name
    assert same(scenario.landmarks_mr, back.scenario.landmarks_mr)
    assert same(scenario.ultrasound.images, back.scenario.ultrasound.images)
    assert back.scenario.truth is None
    assert (back.model is not None) is with_model


def test_a_trigger_and_a_model_of_a_file(tmp_path: Path) -> None:
    model = ball_model()
    pulses = TriggerTimes(np.array([0.1, 0.1 + 0.2, 0.9]), 0.03)
    scenario = replace(recorded(), ecg=pulses, tip=Points("tool", TIP), preop=Preop("ball"))
    back = read_session_log(logged(tmp_path, scenario, given=model))
    assert same(pulses, back.scenario.ecg)
    assert back.model is not None
    np.testing.assert_array_equal(model.coefficients, back.model.coefficients)


def decoded(log: Path) -> dict[str, list[Any]]:
    """Every message as mcap-ros2-support decodes it, by the definitions that the file holds."""
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support decodes independently")
    from mcap.reader import make_reader

    found: dict[str, list[Any]] = {}
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        times: dict[str, list[int]] = {}
        for _, channel, message, ros in reader.iter_decoded_messages():
            assert channel.message_encoding == "cdr"
            found.setdefault(channel.topic, []).append(ros)
            times.setdefault(channel.topic, []).append(message.log_time)
            if hasattr(ros, "header"):
                assert message.log_time == ros.header.stamp.sec * 10**9 + ros.header.stamp.nanosec
    assert all(stamps == sorted(stamps) for stamps in times.values())
    return found


def matrix_m(transform: Any) -> np.ndarray:
    moved, q = transform.transform.translation, transform.transform.rotation
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    matrix[:3, 3] = moved.x, moved.y, moved.z
    return matrix


def test_ros_tools_put_a_point_of_the_tool_at_its_place_in_the_mr(log: Path) -> None:
    """tf2: a transform takes points of the child to the header's frame; metres."""
    placed = [one for message in decoded(log)["/tf"] for one in message.transforms]
    tool = [t for t in placed if (t.header.frame_id, t.child_frame_id) == ("tracker", "tool")]
    tracker = [t for t in placed if (t.header.frame_id, t.child_frame_id) == ("mr", "tracker")]
    assert (len(tool), len(tracker)) == (10, 2)
    at = tool[7].header.stamp
    assert (at.sec, at.nanosec) == (0, 700_000_000)
    tip_m = np.array([*(TIP[0] / 1000), 1.0])
    turn, shift = pose_at(0.7)
    for pose, found in ((FIRST, tracker[0]), (LATER, tracker[1])):
        expected_mm = pose.rotation @ (turn @ TIP[0] + shift) + pose.translation_mm
        place_m = (matrix_m(found) @ matrix_m(tool[7]) @ tip_m)[:3]
        np.testing.assert_allclose(1000 * place_m, expected_mm, atol=1e-9)


def test_images_forces_and_status_as_ros_tools_see_them(log: Path) -> None:
    found = decoded(log)
    image = found["/ultrasound/image"][6]
    assert (image.encoding, image.height, image.width, image.header.frame_id) == ("mono8", 8, 12, "image")
    np.testing.assert_array_equal(np.frombuffer(image.data, np.uint8).nonzero()[0], [4 * 12 + 7])
    first, second = found["/tool/force"]
    assert (first.wrench.force.x, first.header.frame_id) == (0.0, "tracker")
    sent = second.wrench.force
    np.testing.assert_array_equal([sent.x, sent.y, sent.z], FORCE)
    (tip,) = found["/tool/tip"]
    assert tip.header.frame_id == "mr"
    place = tip.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], TIP_MR / 1000)
    status = [message.status[0] for message in found["/diagnostics"]]
    level = [one.level if isinstance(one.level, int) else one.level[0] for one in status]
    assert [(one.message, one.values[0].value) for one in status] == [("fade", "no_pose"), ("ok", "ok")]
    assert level == [2, 0]
    assert found["/guidance"][1].data[0] == 0.25
    (chunk,) = found["/ecg"][:1]
    assert [dim.size for dim in chunk.layout.dim] == [50, 1]


def test_what_cannot_be_logged_or_read_is_refused(tmp_path: Path, log: Path) -> None:
    run = run_folder()
    with pytest.raises(InvalidInputError, match="is a registration"):
        write_session_log(run, tmp_path, tmp_path / "log.mcap")
    other = replace(run, result={"estimates": {"probe_from_image": np.eye(4).tolist()}})
    other = replace(other, scenario=replace(run.scenario, tip=Points("tool", TIP)))
    with pytest.raises(InvalidInputError, match="another seed or version"):
        write_session_log(other, tmp_path, tmp_path / "log.mcap")
    with pytest.raises(OutputError, match="does not exist"):
        logged(tmp_path, replace(run.scenario, tip=Points("tool", TIP)), name="no/such/folder.mcap")


def test_a_changed_bit_of_an_attached_file_is_found(tmp_path: Path, log: Path) -> None:
    data = bytearray(log.read_bytes())
    place = data.index(b"space directions")
    data[place + 30] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(UnreadableFileError, match="attached files are not those that were written"):
        read_session_log(tmp_path / "bad.mcap")


def with_chunk(log: Path, place: Path, content: bytes | None, **changes: Any) -> Path:
    """A log with one chunk, of zeros unless a content is given, in place of its messages."""
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, DataEnd, Footer
    from mcap.stream_reader import StreamReader
    from zstandard import compress

    data, builder = log.read_bytes(), RecordBuilder()
    for record in StreamReader(BytesIO(data), emit_chunks=True).records:
        if isinstance(record, DataEnd):
            break
        if isinstance(record, Chunk):
            held = record.data if content is None else compress(content)
            size = record.uncompressed_size if content is None else len(content)
            record = replace(
                record, **{"data": held, "uncompressed_size": size, "uncompressed_crc": 0} | changes
            )
        record.write(builder)
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    place.write_bytes(data[:8] + builder.end() + data[:8])
    return place


@pytest.mark.parametrize(
    ("content", "changes", "sentence"),
    [
        (300 << 20, {}, "states 314572800 bytes of messages and has"),
        (100, {"uncompressed_size": 1 << 40}, "states a chunk of 1099511627776 bytes that holds 100"),
        (100, {"uncompressed_size": 1}, "states a chunk of 1 bytes that holds 100"),
        (100, {"compression": "lz4"}, "compressed with 'lz4'; needed zstd"),
        (100, {"compression": ""}, "states a chunk of 100 bytes that holds"),
        (b"\x05" + bytes(4), {}, "truncated or damaged"),
        (b"\x05" + (30).to_bytes(8, "little") + bytes(30), {}, "truncated or damaged|lacks messages"),
    ],
)
def test_chunks_that_are_not_what_they_state(
    tmp_path: Path, log: Path, content: bytes | int, changes: dict[str, Any], sentence: str
) -> None:
    """Zeros, or bytes: what unpacks to more than a log can hold takes no memory."""
    assert read_session_log(with_chunk(log, tmp_path / "same.mcap", None)).scenario.name == "known shift"
    bad = with_chunk(log, tmp_path / "bad.mcap", bytes(content), **changes)
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableFileError, match=sentence):
            read_session_log(bad)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("number", "sentence"),
    [
        (float("nan"), "bad.mcap: the tool's poses holds a value that is not finite"),
        (1e9, "bad.mcap: the tool's poses reaches 1e.09 mm"),
        (None, r"truncated or damaged \(.*(sequence|size|deserialize).*copy it again"),
    ],
)
def test_messages_with_broken_content_are_refused_in_one_sentence(
    tmp_path: Path, log: Path, number: float | None, sentence: str
) -> None:
    """The last number of the tool's first pose, or the length of its list."""
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Message
    from mcap.stream_reader import StreamReader, breakup_chunk

    records = StreamReader(BytesIO(log.read_bytes()), emit_chunks=True).records
    chunk = next(record for record in records if isinstance(record, Chunk))
    inner, names, changed = RecordBuilder(), dict[int, str](), False
    for record in breakup_chunk(chunk):
        names |= {record.id: record.topic} if hasattr(record, "topic") else {}
        if isinstance(record, Message) and names[record.channel_id] == EXACT_TOOL and not changed:
            data, changed = bytearray(record.data), True
            if number is None:
                data[-120:-112] = b"\xff\xff\xff\x7f" * 2
            else:
                data[-8:] = struct.pack("<d", number)
            record.data = bytes(data)
        record.write(inner)
    assert changed
    with pytest.raises(UnreadableFileError, match=sentence) as caught:
        read_session_log(with_chunk(log, tmp_path / "bad.mcap", inner.end()))
    assert "\n" not in str(caught.value)


def test_damaged_logs_are_refused_in_one_sentence(tmp_path: Path, log: Path) -> None:
    data = log.read_bytes()
    rng = np.random.default_rng(3)
    damaged = [b"", b"no log", data[: len(data) // 2], data[:-200]]
    for _ in range(20):
        broken = bytearray(data)
        for place in rng.integers(8, len(data), 4).tolist():
            broken[place] ^= 0xFF
        damaged.append(bytes(broken))
    refused = []
    for content in damaged:
        (tmp_path / "bad.mcap").write_bytes(content)
        try:
            read_session_log(tmp_path / "bad.mcap")
        except UnreadableFileError as error:
            refused.append(str(error))
    assert len(refused) >= 20
    assert all("bad.mcap" in told and "\n" not in told for told in refused)
