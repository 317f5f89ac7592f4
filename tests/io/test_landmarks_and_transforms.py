"""Landmarks and transforms: known shifts read by plain parsing and SimpleITK, RAS to LPS, and bad files."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    FrameMismatchError,
    InvalidInputError,
    Landmarks,
    OutputError,
    Points,
    Rigid,
    UnreadableFileError,
)
from dvf_ig.io import (
    read_landmarks,
    read_points,
    read_tag_pair,
    read_transform,
    write_landmarks,
    write_transform,
)

POINTS = Landmarks(
    ("apex", "mitral, septal", "RV–LV"), Points("mr", np.array([[1.5, 2, 3], [4, 5, 6], [0.1, -7, 1e-9]]))
)


def test_markups_round_trip(tmp_path: Path) -> None:
    write_landmarks(POINTS, tmp_path / "a.mrk.json")
    back = read_landmarks(tmp_path / "a.mrk.json", "mr")
    assert back.names == POINTS.names
    assert back.frame == "mr"
    np.testing.assert_array_equal(back.points.xyz_mm, POINTS.points.xyz_mm)


def test_markups_read_by_a_plain_parser(tmp_path: Path) -> None:
    write_landmarks(POINTS, tmp_path / "a.mrk.json")
    markup = json.loads((tmp_path / "a.mrk.json").read_text())["markups"][0]
    assert (markup["type"], markup["coordinateSystem"]) == ("Fiducial", "LPS")
    assert markup["controlPoints"][0]["label"] == "apex"
    assert markup["controlPoints"][0]["position"] == [1.5, 2.0, 3.0]


def markups(system: str, **point: object) -> str:
    points = [{"label": "a", "position": [1, 2, 3]}, {"label": "b", "position": [0, 0, 0], **point}]
    return json.dumps({"markups": [{"coordinateSystem": system, "controlPoints": points}]})


@pytest.mark.parametrize(("system", "x"), [("LPS", 1), ("RAS", -1), ("1", 1), ("0", -1)])
def test_markups_coordinate_systems(tmp_path: Path, system: str, x: float) -> None:
    (tmp_path / "a.mrk.json").write_text(markups(system, positionStatus="undefined"))
    back = read_landmarks(tmp_path / "a.mrk.json", "mr")
    assert back.names == ("a",)
    assert back.points.xyz_mm.tolist() == [[x, 2 * x, 3]]


def test_fcsv(tmp_path: Path) -> None:
    text = (
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = RAS\n"
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        'vtkMRMLMarkupsFiducialNode_0,1,2,3,0,0,0,1,1,1,0,"F, one",,\n'
        "vtkMRMLMarkupsFiducialNode_1,4,5,6,0,0,0,1,1,1,0,F-2,,\n"
    )
    (tmp_path / "a.fcsv").write_text(text)
    back = read_landmarks(tmp_path / "a.fcsv", "mr")
    assert back.names == ("F, one", "F-2")
    assert back.points.xyz_mm.tolist() == [[-1, -2, 3], [-4, -5, 6]]
    (tmp_path / "a.fcsv").write_text(text.replace("RAS", "LPS"))
    assert read_landmarks(tmp_path / "a.fcsv", "mr").points.xyz_mm[0].tolist() == [1, 2, 3]
    (tmp_path / "a.fcsv").write_bytes(text.replace("F-2", "größer").encode("latin-1"))
    assert read_landmarks(tmp_path / "a.fcsv", "mr").names == ("F, one", "größer")
    (tmp_path / "a.fcsv").write_text(text.replace("# CoordinateSystem = RAS\n", ""))
    with pytest.raises(UnreadableFileError, match="names no CoordinateSystem"):
        read_landmarks(tmp_path / "a.fcsv", "mr")


def test_points_that_were_not_placed_are_left_out_by_name(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Slicer 5 writes a status after the named columns: 0 undefined, 1 preview, 2 defined, 3 missing."""
    rows = [(2, 5, "a", 1), (0, 0, "b", 1), (3, 0, "c", 1), (2, 7, "hidden", 0), (2, 0, "origin", 1)]
    columns = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
    text = f"# CoordinateSystem = LPS\n# columns = {columns}\n"
    text += "".join(f"1,{x},0,0,0,0,0,1,{vis},1,0,{n},,,{s},0\n" for s, x, n, vis in rows)
    (tmp_path / "a.fcsv").write_text(text)
    statuses = {0: "undefined", 2: "defined", 3: "missing"}
    points = [
        {"label": n, "position": [x, 0, 0], "positionStatus": statuses[s], "visibility": bool(vis), "fog": 1}
        for s, x, n, vis in rows
    ]
    (tmp_path / "a.mrk.json").write_text(json.dumps({"markups": [{"controlPoints": points}]}))
    for name in ("a.fcsv", "a.mrk.json"):
        caplog.clear()
        back = read_landmarks(tmp_path / name, "mr")
        assert back.names == ("a", "hidden", "origin")
        assert "points b, c are not placed in 3D Slicer and left out" in caplog.text
        assert "points hidden are hidden or not selected in 3D Slicer, and used" in caplog.text
        assert "points origin are exactly at 0, 0, 0" in caplog.text
        assert ("the fields fog are not known" in caplog.text) == (name == "a.mrk.json")
    (tmp_path / "a.fcsv").write_text(text.replace(",,,2,0", ",,,7,0", 1))
    with pytest.raises(UnreadableFileError, match="the status of 'a' is '7'"):
        read_landmarks(tmp_path / "a.fcsv", "mr")


def marked(points: list[list[float]], **markup: object) -> str:
    rows = [{"label": str(i), "position": xyz} for i, xyz in enumerate(points)]
    return json.dumps({"markups": [{"controlPoints": rows, **markup}]})


def test_units_and_kinds_of_markups(tmp_path: Path) -> None:
    path = tmp_path / "a.mrk.json"
    path.write_text(marked([[1, 2, 3]], coordinateUnits=["mm", "UCUM", "millimeter"]))
    assert read_landmarks(path, "mr").points.xyz_mm.tolist() == [[1, 2, 3]]
    for markup, message in (
        ({"coordinateUnits": ["m", "UCUM", "meter"]}, "its units are .*meter.*; needed mm"),
        ({"type": "ROI"}, "holds a markup 'ROI'; needed Fiducial"),
        ({"type": "ClosedCurve"}, "holds a markup 'ClosedCurve'"),
    ):
        path.write_text(marked([[1, 2, 3]], **markup))
        with pytest.raises(UnreadableFileError, match=message):
            read_landmarks(path, "mr")


def test_landmarks_in_metres_are_refused(tmp_path: Path) -> None:
    points = np.array([[0.01, 0.02, 0.03], [-0.015, 0.04, 0.055], [0.042, 0.008, 0.025]])
    (tmp_path / "a.mrk.json").write_text(marked(points.tolist()))
    (tmp_path / "a.csv").write_text("\n".join(",".join(map(str, row)) for row in points))
    (tmp_path / "um.csv").write_text("\n".join(",".join(map(str, row * 1e6)) for row in points))
    for read, name in ((read_landmarks, "a.mrk.json"), (read_points, "a.mrk.json"), (read_points, "a.csv")):
        with pytest.raises(UnreadableFileError, match=r"0\.057 mm across.* it is in m \(then 57 mm\)"):
            read(tmp_path / name, "mr")
    with pytest.raises(UnreadableFileError, match=r"it is in um \(then 57 mm\)"):
        read_points(tmp_path / "um.csv", "mr")


@pytest.mark.parametrize(
    ("text", "xyz"),
    [
        ("x,y,z\n1,2,3\n", [1, 2, 3]),
        ("z;x;y\n3,5;1,5;2,5\n", [1.5, 2.5, 3.5]),
        ("R A S\n1 2 3\n", [-1, -2, 3]),
        ("x [m],y [m],z [m]\n0.1,0.2,0.3\n", [100, 200, 300]),
        ("1 2 3\n", [1, 2, 3]),
    ],
)
def test_points_of_a_table(tmp_path: Path, text: str, xyz: list[float]) -> None:
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_allclose(read_points(tmp_path / "a.csv", "mr").xyz_mm, [xyz], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,,3\n4,5,6\n", "line 1: a cell is empty"),
        ("x,y,w\n1,2,3\n", "columns \\(x, y, w\\); needed x,y,z"),
        ("x,y,z\n1,2\n", "line 2: 2 cells under 3 names"),
        ("1,2,3,4\n", "has 4 columns"),
        ("x [km],y,z\n1,2,3\n", "column 1 is in 'km'"),
        ("# coordinate system: RAS\nx,y,z\n1,2,3\n", "a comment says 'RAS', and points are read as LPS"),
        ("# units: m\nx,y,z\n1,2,3\n", "a comment says 'units: m'"),
    ],
)
def test_bad_tables_of_points(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_points(tmp_path / "a.csv", "mr")


PAIR = (
    "MNI Tag Point File\nVolumes = 2;\n% Volume 1: us.mnc\n% Volume 2: mr.mnc\n\nPoints =\n"
    ' 1.0 2.0 3.0 4.0 5.0 6.0 "P1"\n -1.5e+00 0 2 7 8 9 "P2";\n'
)


def test_tag_pair(tmp_path: Path) -> None:
    (tmp_path / "a.tag").write_text(PAIR)
    first, second = read_tag_pair(tmp_path / "a.tag", "us", "mr")
    assert (first.frame, second.frame) == ("us", "mr")
    assert first.names == second.names == ("P1", "P2")
    assert first.points.xyz_mm.tolist() == [[-1, -2, 3], [1.5, 0, 2]]
    assert second.points.xyz_mm.tolist() == [[-4, -5, 6], [-7, -8, 9]]
    with pytest.raises(UnreadableFileError, match="read it as a pair"):
        read_landmarks(tmp_path / "a.tag", "mr")


def tag(rows: str, more: str = "") -> str:
    return f"MNI Tag Point File\nVolumes = 1;\n{more}Points =\n{rows};\n"


@pytest.mark.parametrize(
    ("text", "names", "note"),
    [
        (tag(' 1 2 3 "a;b"\n 40 5 6 "c%d"'), ("a;b", "c%d"), ""),
        (tag("% made; by hand\n 1 2 3\n 40 5 6"), ("1", "2"), ""),
        ("\n" + tag(" 1 2 3\n 40 5 6", more="% Volumes = 2;\n"), ("1", "2"), ""),
        (
            tag(' 1 2 3 0 1 1 "a"\n 40 5 6 1 1 1 "b"'),
            ("a", "b"),
            "have different weights, which are not used",
        ),
        (tag(' 1 2 3 "a"\n 40 5 6 "a"'), ("1", "2"), "the name a repeats"),
        (tag(' 0 0 0 "a"\n 40 5 6 "b"'), ("a", "b"), "points a are exactly at 0, 0, 0"),
    ],
)
def test_tags_as_programs_write_them(
    tmp_path: Path, text: str, names: tuple[str, ...], note: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "a.tag").write_text(text)
    back = read_landmarks(tmp_path / "a.tag", "mr")
    assert back.names == names
    assert back.points.xyz_mm[1].tolist() == [-40, -5, 6]
    assert note in caplog.text
    assert bool(note) == bool(caplog.text)


def test_tag_of_one_volume_without_names(tmp_path: Path) -> None:
    (tmp_path / "a.tag").write_text('MNI Tag Point File\nVolumes = 1;\nPoints =\n 1 2 3 ""\n 4 5 6 "";\n')
    back = read_landmarks(tmp_path / "a.tag", "mr")
    assert back.names == ("1", "2")
    with pytest.raises(UnreadableFileError, match="needed those of two volumes"):
        read_tag_pair(tmp_path / "a.tag", "a", "b")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.mrk.json", "{", "line 1"),
        ("a.mrk.json", "[]", "not a 3D Slicer markups file"),
        ("a.mrk.json", '{"markups": []}', "holds no points"),
        ("a.mrk.json", markups("ABC"), "coordinate system is 'ABC'"),
        ("a.mrk.json", markups("LPS", label="a"), "names repeat"),
        ("a.mrk.json", markups("LPS", position=[1, "x"]), "not three numbers"),
        ("a.mrk.json", markups("LPS", position=[1, 2]), "a.mrk.json"),
        ("a.fcsv", "# CoordinateSystem = LPS\nid,a,b,c\n", "not a 3D Slicer fiducial list"),
        ("a.fcsv", "# CoordinateSystem = LPS\n# CoordinateSystem = RAS\n", "states CoordinateSystem twice"),
        ("a.fcsv", "# CoordinateSystem = LPS\n# coordinateUnits = m\n", "its units are m; needed mm"),
        ("a.tag", "MNI", "not an MNI tag file"),
        ("a.tag", 'MNI Tag Point File\nVolumes = 1;\nPoints =\n 1 2 "x";\n', "3 coordinates each"),
        ("a.tag", "MNI Tag Point File\nVolumes = 1;\nPoints =\n one;\n", "'one' is not a row"),
        ("a.tag", tag(" 1 2 3 4.5 5.5 6.5"), "has 6 numbers; needed 3 for 1 volumes"),
        ("a.tag", tag(" 1 2 3 1 -1 -1 7"), "has 7 numbers"),
        ("a.tag", tag(" 1 2 3") + "Points =\n 4 5 6;\n", "'Points' is not known, or there twice"),
        ("a.tag", tag(" 1 2 3", more="Units = m;\n"), "'Units' is not known"),
        ("a.tag", tag(" 1 2 3", more="Volumes = 2;\n"), "'Volumes' is not known, or there twice"),
        ("a.tag", tag(" 1 2 3") + "left over", "goes on after its end"),
        ("a.tag", tag(""), "holds no points"),
        ("a.xyz", "", "no landmark ending"),
    ],
)
def test_bad_landmarks(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_landmarks(tmp_path / name, "mr")


def rigid(seed: int) -> Rigid:
    rng = np.random.default_rng(seed)
    return Rigid("mr", "tracker", Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 100)


@given(seed=st.integers(0, 2**32))
def test_transform_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    path = tmp_path_factory.mktemp("case") / "t.tfm"
    write_transform(rigid(seed), path, error_mm=0.4)
    back = read_transform(path)
    assert back.name == "mr_from_tracker"
    np.testing.assert_array_equal(back.matrix, rigid(seed).matrix)


def test_known_shift_read_by_simpleitk(tmp_path: Path) -> None:
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    write_transform(Rigid("mr", "tracker", turn, np.array([10.0, 20, 30])), tmp_path / "t.tfm", error_mm=0.7)
    transform = SimpleITK.ReadTransform(str(tmp_path / "t.tfm"))
    np.testing.assert_allclose(transform.TransformPoint((1.0, 0, 0)), (10, 21, 30), atol=1e-12)
    sidecar = json.loads((tmp_path / "t.json").read_text())
    assert (sidecar["from"], sidecar["to"], sidecar["error_mm"]) == ("tracker", "mr", 0.7)
    assert "fixed" in sidecar["convention"]


@pytest.mark.parametrize("ending", ["tfm", "h5"])
def test_transforms_of_simpleitk(tmp_path: Path, ending: str) -> None:
    euler = SimpleITK.Euler3DTransform((5.0, 6, 7), 0.1, 0.2, 0.3, (1.0, 2, 3))
    shift = SimpleITK.TranslationTransform(3, (4.0, 0, 0))
    path = tmp_path / f"t.{ending}"
    for transform in (euler, SimpleITK.CompositeTransform([shift, euler])):
        SimpleITK.WriteTransform(transform, str(path))
        back = read_transform(path, target="moving", source="fixed")
        np.testing.assert_allclose(
            back.apply_array(np.array([9.0, -8, 7])), transform.TransformPoint((9.0, -8, 7)), atol=1e-9
        )


def test_frames_of_a_transform(tmp_path: Path) -> None:
    write_transform(rigid(1), tmp_path / "t.tfm")
    assert read_transform(tmp_path / "t.tfm", target="mr").source == "tracker"
    with pytest.raises(FrameMismatchError, match="mr_from_tracker; needed ct_from_tracker"):
        read_transform(tmp_path / "t.tfm", target="ct")
    (tmp_path / "t.json").write_text('{"something": "else"}')
    assert read_transform(tmp_path / "t.tfm", "ct", "us").name == "ct_from_us"
    (tmp_path / "t.json").unlink()
    with pytest.raises(InvalidInputError, match=r"add a file t\.json"):
        read_transform(tmp_path / "t.tfm")


def test_bad_transforms(tmp_path: Path) -> None:
    path = tmp_path / "t.tfm"
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_transform(path)
    path.write_text("nonsense")
    with pytest.raises(UnreadableFileError, match="not a readable ITK transform"):
        read_transform(path, "a", "b")
    scaled = SimpleITK.AffineTransform(3)
    scaled.Scale(1.1)
    SimpleITK.WriteTransform(scaled, str(path))
    with pytest.raises(UnreadableFileError, match="is not rigid"):
        read_transform(path, "a", "b")
    grid = SimpleITK.DisplacementFieldTransform(SimpleITK.Image((3, 3, 3), SimpleITK.sitkVectorFloat64))
    SimpleITK.WriteTransform(grid, str(tmp_path / "d.h5"))
    with pytest.raises(UnreadableFileError, match="not a linear 3-D transform"):
        read_transform(tmp_path / "d.h5", "a", "b")
    with pytest.raises(OutputError, match=r"\.tfm"):
        write_transform(rigid(1), tmp_path / "t.mat")


def test_other_columns_of_points_are_left_out_by_name(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "a.csv").write_text(",label,x,y,z,grey\n0,apex,1,2,3,9\n1,base,40,50,60,9\n")
    assert read_points(tmp_path / "a.csv", "mr").xyz_mm.tolist() == [[1, 2, 3], [40, 50, 60]]
    assert "the columns without a name, grey, label are no coordinates" in caplog.text


def test_fiducials_that_a_spreadsheet_saved(tmp_path: Path) -> None:
    columns = "columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label"
    row = "1,10,20,30,0,0,0,1,1,1,0,apex"
    (tmp_path / "a.fcsv").write_text(f'# CoordinateSystem = RAS,,,,,\n"# {columns}"\n{row}\n')
    assert read_landmarks(tmp_path / "a.fcsv", "mr").points.xyz_mm.tolist() == [[-10, -20, 30]]
    (tmp_path / "a.fcsv").write_text(f"# CoordinateSystem = RAS\n# {columns}\n{row.replace(',', ';')}\n")
    with pytest.raises(UnreadableFileError, match="separated by semicolons, as a spreadsheet saves them"):
        read_landmarks(tmp_path / "a.fcsv", "mr")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "Transform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 5 6 7\n"
            "FixedParameters: 0 0 0\n" * 2,
            "holds 2 transforms and does not say that they are applied one after the other",
        ),
        (
            "Transform: AffineTransform_double_2_2\nParameters: 1 0 0 1 5 6\nFixedParameters: 0 0\n",
            "transform of 2-D images",
        ),
        (
            "Transform: BSplineTransform_double_3_3\nParameters: 0\nFixedParameters: 4 4 4 0 0 0 1 1 1\n",
            "holds a BSplineTransform, which is not linear",
        ),
    ],
)
def test_transforms_whose_kind_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.tfm").write_text(f"#Insight Transform File V1.0\n#Transform 0\n{text}")
    with pytest.raises(UnreadableFileError, match=message):
        read_transform(tmp_path / "t.tfm", "a", "b")
