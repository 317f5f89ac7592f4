"""PLUS XML: coordinate definitions, phantoms, wire points, line tables; real files and round trips."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import nwire_of

from dvf_ig.core import InvalidInputError, Rigid, Scenario, UnreadableFileError
from dvf_ig.io import (
    CoordinateDefinition,
    read_calibrations,
    read_coordinate_definitions,
    read_image_map,
    read_latency_recording,
    read_line_table,
    read_nwire_phantom,
    read_nwire_recording,
    read_probe,
    read_wire_points,
    write_coordinate_definitions,
    write_json,
    write_line_table,
    write_nwire_phantom,
    write_wire_points,
)
from dvf_ig.io.plus.names import frame_from_plus, frame_to_plus, join_transform, split_transform

Make = Callable[..., object]


@pytest.mark.parametrize(
    ("plus", "frame"),
    [
        ("Probe", "probe"),
        ("StylusTip", "stylus_tip"),
        ("TransducerOriginPixel", "transducer_origin_pixel"),
        ("MRImage", "mr_image"),
        ("Tool-1", "tool_1"),
    ],
)
def test_frame_names(plus: str, frame: str) -> None:
    assert frame_from_plus(plus) == frame


@given(st.from_regex(r"[a-z][a-z0-9]{0,8}(_[a-z][a-z0-9]{0,8}){0,2}", fullmatch=True))
def test_every_written_name_reads_back(frame: str) -> None:
    try:
        name = frame_to_plus(frame)
    except InvalidInputError:
        return
    assert frame_from_plus(name) == frame


@pytest.mark.parametrize("pair", [("tracker", "probe"), ("tool", "torso"), ("stylus", "stylus_tip")])
def test_transform_names_split_where_they_were_joined(pair: tuple[str, str]) -> None:
    assert split_transform(join_transform(*pair)) == pair


@pytest.mark.parametrize("frame", ["tool_2", "a__b"])
def test_names_that_would_come_back_changed(frame: str) -> None:
    with pytest.raises(InvalidInputError, match="rename it"):
        frame_to_plus(frame)


def test_real_device_set(data_dir: Path) -> None:
    path = data_dir / "plus-fcal20-nwire" / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
    placed = read_calibrations(path)["reference_from_phantom"]
    assert placed.error_mm == 0.660751
    assert placed.date == "091112_152716"
    assert placed.matrix[0].tolist() == [-0.0167397, -0.0153548, -0.999742, 15.6642]
    phantom = read_nwire_phantom(path)
    assert [wire.name[:1] for wire in phantom.wires] == list("789456123")
    assert phantom.patterns[2][1].back_mm.tolist() == [40, 40, 0]


def test_definitions_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = (np.vstack([rng.normal(size=(3, 4)), [0.0, 0.0, 0.0, 1.0]]) for _ in range(2))
    definitions = [
        CoordinateDefinition("probe", "image", first, 0.3, "2026.01.02 03:04:05"),
        CoordinateDefinition("stylus", "stylus_tip", np.diag([1e-9, 1e-9, 1e-9, 1.0]) @ second),
    ]
    write_coordinate_definitions(tmp_path / "a.xml", definitions)
    back = read_calibrations(tmp_path / "a.xml")
    assert list(back) == ["probe_from_image", "stylus_from_stylus_tip"]
    for one in definitions:
        np.testing.assert_array_equal(back[one.name].matrix, one.matrix)
        assert (back[one.name].error_mm, back[one.name].date) == (one.error_mm, one.date)
    plain = read_coordinate_definitions(tmp_path / "a.xml")
    write_coordinate_definitions(tmp_path / "b.xml", plain)
    again = read_coordinate_definitions(tmp_path / "b.xml")
    assert all(np.array_equal(again[name], plain[name]) for name in plain)


def test_definitions_read_by_a_plain_parser(tmp_path: Path) -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    write_coordinate_definitions(tmp_path / "a.xml", {"reference_from_phantom": matrix})
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    element = root.find("./CoordinateDefinitions/Transform")
    assert root.tag == "PlusConfiguration"
    assert element is not None
    assert (element.attrib["From"], element.attrib["To"]) == ("Phantom", "Reference")
    numbers = [float(n) for n in element.attrib["Matrix"].split()]
    assert numbers == [1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]


def test_real_nwire_recording(data_dir: Path) -> None:
    folder = data_dir / "plus-fcal20-nwire"
    recording = read_nwire_recording(
        folder / "fCal_Test_Validation_3NWires_fCal2.0.igs.mha",
        folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml",
        folder / "FreehandCalibration3NWires_fCal2.0.results.xml",
        "ValidationData",
    )
    assert recording.points_px.shape == (103, 9, 2)
    assert recording.points_px[0, 0].tolist() == [605.737, 191.888]
    assert np.isfinite(recording.points_px).all()
    pose = recording.phantom_from_probe.pose(0)
    assert (pose.target, pose.source) == ("phantom", "probe")
    published = np.array(
        [
            [-0.000519165, 0.0744587, 0.000837223, 11.2137],
            [-0.0803067, -6.68987e-005, 0.00174527, 48.4162],
            [0.00181709, -0.000804192, 0.0773718, -0.398993],
        ]
    )
    seen = pose.apply_array(published @ (*recording.points_px[0, 0], 0, 1))
    wire = recording.phantom.wires[0]
    along = (wire.back_mm - wire.front_mm) / np.linalg.norm(wire.back_mm - wire.front_mm)
    off = (seen - wire.front_mm) - ((seen - wire.front_mm) @ along) * along
    assert np.linalg.norm(off) < 0.6, "the published calibration puts the first wire where it was seen"


def test_failed_frames_are_nan(data_dir: Path) -> None:
    folder = data_dir / "plus-fcal20-nwire"
    phantom = read_nwire_phantom(folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml")
    results = folder / "FreehandCalibration3NWires_fCal2.0.results.xml"
    points = read_wire_points(results, "CalibrationData", phantom)
    assert points.shape == (190, 9, 2)
    assert np.isnan(points).all(axis=(1, 2)).sum() == np.isnan(points).any(axis=(1, 2)).sum() == 6
    with pytest.raises(UnreadableFileError, match="frame 100, the recording has 100"):
        read_wire_points(results, "CalibrationData", phantom, frames=100)


def test_wire_points_round_trip(tmp_path: Path, make_scenario: Callable[..., Scenario]) -> None:
    recording = nwire_of(make_scenario(4))
    write_wire_points(tmp_path / "p.xml", "ValidationData", recording.phantom, recording.points_px)
    back = read_wire_points(tmp_path / "p.xml", "ValidationData", recording.phantom)
    np.testing.assert_array_equal(back, recording.points_px)
    with pytest.raises(UnreadableFileError, match="no <CalibrationData>"):
        read_wire_points(tmp_path / "p.xml", "CalibrationData", recording.phantom)
    with pytest.raises(InvalidInputError, match=r"needed .frames, 6, 2."):
        write_wire_points(tmp_path / "q.xml", "CalibrationData", recording.phantom, np.zeros((2, 3, 2)))


def test_phantom_round_trip(tmp_path: Path, make_scenario: Callable[..., Scenario]) -> None:
    phantom = nwire_of(make_scenario(4)).phantom
    placed = Rigid("reference", "phantom", np.eye(3), np.array([1.0, 2, 3]))
    write_nwire_phantom(tmp_path / "d.xml", phantom, placed)
    back = read_nwire_phantom(tmp_path / "d.xml")
    for one, two in zip(back.wires, phantom.wires, strict=True):
        assert one.name == two.name
        np.testing.assert_array_equal(one.front_mm, two.front_mm)
        np.testing.assert_array_equal(one.back_mm, two.back_mm)
    matrix = read_coordinate_definitions(tmp_path / "d.xml")["reference_from_phantom"]
    np.testing.assert_array_equal(matrix, placed.matrix)


def test_real_line_table(data_dir: Path) -> None:
    folder = data_dir / "plus-temporal-watertank"
    recording = read_latency_recording(
        folder / "WaterTankBottomTranslationTrackerBuffer.igs.mha",
        folder / "WaterTankBottomTranslationVideoBuffer.igs.mha",
        folder / "LineSegmentationResultsBaseline.xml",
    )
    assert len(recording.tracker_from_probe) == 5000
    assert len(recording.wall_row_px.t_s) == 201
    slope = -0.23826220 / 0.97120087
    assert recording.wall_row_px.values[0] == pytest.approx(230.52409412 + (409.5 - 381.6875) * slope)


def test_line_table_leaves_failed_frames_out(tmp_path: Path) -> None:
    write_line_table(tmp_path / "l.xml", np.array([10.0, np.nan, 12.5]))
    index, rows = read_line_table(tmp_path / "l.xml", column_px=77.0)
    assert index.tolist() == [0, 2]
    assert rows.tolist() == [10.0, 12.5]


BAD = [
    ("<a>", "is not a PLUS"),
    ("<a/>", "no <CoordinateDefinitions>"),
    ("<CoordinateDefinitions><Transform From='A'/></CoordinateDefinitions>", "lacks From or To"),
    (
        "<CoordinateDefinitions><Transform From='A' To='B' Matrix='1 2 x'/></CoordinateDefinitions>",
        "Matrix of <Transform> is '1 2 x'; needed 16",
    ),
    (
        f"<CoordinateDefinitions><Transform From='A' To='B' Matrix='{'nan ' * 16}'/></CoordinateDefinitions>",
        "16 finite numbers",
    ),
    (
        f"<CoordinateDefinitions><Transform From='A' To='B' Matrix='{'1 0 0 0 ' * 3} 5 6 7 1'/>"
        "</CoordinateDefinitions>",
        "last row .*needed 0 0 0 1: write it row by row",
    ),
]


@pytest.mark.parametrize(("text", "message"), BAD)
def test_bad_definitions(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_calibrations(tmp_path / "a.xml")


def test_bad_phantoms(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text("<PhantomDefinition/>")
    with pytest.raises(UnreadableFileError, match="no NWire pattern"):
        read_nwire_phantom(path)
    path.write_text(
        "<G><Pattern Type='NWire'><Wire Name='1' EndPointFront='0 0 0' EndPointBack='1 0 0'/></Pattern></G>"
    )
    with pytest.raises(UnreadableFileError, match="has 1 wires; needed 3"):
        read_nwire_phantom(path)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ("<Frame Index='0' SegmentationStatus='Failed'/>", "none of its 1 frames"),
        ("<Frame Index='0' LineOriginPointPx='1 2' LineDirectionVectorPx='0 1'/>", "frame 0 is vertical"),
        ("<Frame Index='0' LineOriginPointPx='1' LineDirectionVectorPx='1 0'/>", "LineOriginPointPx"),
        ("<Frame Index='0' LineOriginPointPx='1 2' LineDirectionVectorPx='1 0'/>" * 2, "index repeats"),
    ],
)
def test_bad_line_tables(tmp_path: Path, frame: str, message: str) -> None:
    (tmp_path / "l.xml").write_text(f"<LineSegmentationResults>{frame}</LineSegmentationResults>")
    with pytest.raises(UnreadableFileError, match=message):
        read_line_table(tmp_path / "l.xml")


def test_the_image_is_reached_through_a_chain_or_not_at_all(tmp_path: Path) -> None:
    """Pixels of 0.1 mm to the transducer, 5 mm along x from the sensor; the wrong one reverses rows."""
    path, scaled, shifted = tmp_path / "a.xml", np.diag([0.1, 0.1, 0.1, 1.0]), np.eye(4)
    shifted[0, 3] = 5.0
    chain = {"transducer_from_image": scaled, "transducer_from_probe": np.linalg.inv(shifted)}
    write_coordinate_definitions(path, chain)
    np.testing.assert_allclose(read_image_map(path).matrix[:, [0, 1, 3]], (shifted @ scaled)[:, [0, 1, 3]])
    write_coordinate_definitions(path, {**chain, "probe_from_image": shifted @ scaled})
    read_image_map(path)
    write_coordinate_definitions(
        path, {**chain, "probe_from_image": shifted @ scaled @ np.diag([1, -1, 1, 1])}
    )
    with pytest.raises(
        UnreadableFileError, match=r"image to transducer to probe and image to probe .* 100 mm apart"
    ):
        read_image_map(path)
    text = path.read_text()
    path.write_text(
        text.replace(
            "</CoordinateDefinitions>",
            "<Transform From='Image' To='Probe' Matrix='"
            + "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1'/></CoordinateDefinitions>",
        )
    )
    with pytest.raises(UnreadableFileError, match="holds probe_from_image twice, with different matrices"):
        read_image_map(path)


@pytest.mark.parametrize(
    ("stated", "turned_from", "sentence"),
    [
        ({"image_orientation": "MF"}, "UFA", None),
        ({"image_orientation": None}, None, None),
        ({}, "UFA", "an orientation that is not stated, and the recording's, stored as UFA"),
        ({"image_orientation": "UF"}, None, "calibrates images in UF"),
        ({"image_orientation": "FM"}, "UFA", "calibrates images in FM"),
    ],
)
def test_orientation_of_calibration_and_recording_are_compared(
    tmp_path: Path, stated: dict[str, object], turned_from: str | None, sentence: str | None
) -> None:
    verdict = {"kind": "probe", "refused": False, "refused_because": [], "sensor_frame": "probe"}
    write_json(tmp_path / "a.json", {**verdict, "sensor_from_image": np.diag([0.1, 0.1, 1, 1]), **stated})
    with nullcontext() if sentence is None else pytest.raises(UnreadableFileError, match=sentence):
        read_probe(tmp_path / "a.json", turned_from=turned_from)
