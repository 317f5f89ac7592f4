"""A scene folder read back without our readers: what was tracked lies where it is known to lie in the MR.

What 3D Slicer does is written out here by its sources: a transform node's file is the inverse of *transform
to parent* in LPS; nodes hang on each other by the role "transform"; images and meshes are LPS in files,
RAS in the scene; a transform sequence holds *transform to parent* as it stands.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import SimpleITK
from toy_ball import ball_model
from toy_run import (
    BRIGHT,
    FIRST,
    LAG_S,
    LATER,
    MR_GRID,
    PROBE_FROM_IMAGE,
    TIP,
    TOUCHED,
    pose_at,
    recorded,
    run_folder,
)
from toy_sphere import sphere

from dvf_ig.core import Grid, InvalidInputError, Mesh, Rigid, Tissue, UnreadableFileError, Volume, Warp
from dvf_ig.io import read_mesh
from dvf_ig.replay.export.exported_run import read_exported_run
from dvf_ig.replay.export.slicer_scene import write_slicer_scene

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene")
    write_slicer_scene(run_folder(), ball_model(), path)
    return path


class Slicer:
    """The scene as 3D Slicer reads it, as far as places go."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        root = ElementTree.parse(folder / "scene.mrml").getroot()
        assert root.tag == "MRML"
        assert root.attrib["version"].startswith("Slicer5")
        self.nodes = {node.attrib["id"]: node for node in root}
        assert len(self.nodes) == len(root)
        self.matrices: dict[str, np.ndarray] = {}

    def references(self, node: ElementTree.Element) -> dict[str, str]:
        pairs = (entry.split(":") for entry in node.attrib.get("references", "").split(";") if entry)
        return dict(tuple(pair) for pair in pairs)  # type: ignore[misc]

    def named(self, name: str) -> ElementTree.Element:
        (node,) = [n for n in self.nodes.values() if n.attrib["name"] == name]
        return node

    def file(self, node: ElementTree.Element) -> Path:
        return self.folder / self.nodes[self.references(node)["storage"]].attrib["fileName"]

    def to_parent(self, node: ElementTree.Element) -> np.ndarray:
        if node.attrib["id"] in self.matrices:
            return self.matrices[node.attrib["id"]]
        transform = SimpleITK.ReadTransform(str(self.file(node)))
        matrix = np.eye(4)
        matrix[:3, 3] = transform.TransformPoint((0.0, 0.0, 0.0))
        for axis in range(3):
            matrix[:3, axis] = np.array(transform.TransformPoint(np.eye(3)[axis].tolist())) - matrix[:3, 3]
        return np.asarray(np.linalg.inv(FLIP @ matrix @ FLIP))

    def to_world(self, node: ElementTree.Element) -> np.ndarray:
        """From a node's own coordinates to the scene."""
        matrix = np.eye(4)
        while (parent := self.references(node).get("transform")) is not None:
            node = self.nodes[parent]
            matrix = self.to_parent(node) @ matrix
        return matrix

    def points(self, name: str) -> tuple[np.ndarray, list[str]]:
        """Of markups, in the scene; and their descriptions."""
        node = self.named(name)
        (markup,) = json.loads(self.file(node).read_text())["markups"]
        signs = {"LPS": (-1, -1, 1), "RAS": (1, 1, 1)}[markup["coordinateSystem"]]
        xyz = np.array([point["position"] for point in markup["controlPoints"]]) * signs
        return moved(self.to_world(node), xyz), [p["description"] for p in markup["controlPoints"]]

    def play(self, item: int) -> str:
        """Step the recording's browser: transforms take the matrices of the item. Returns its index value."""
        browser = self.named("recording")
        references = self.references(browser)
        value = ""
        for postfix in browser.attrib["virtualNodePostfixes"].split():
            sequence = self.nodes[references[f"sequenceNodeRef{postfix}"]]
            shown = references[f"dataNodeRef{postfix}"]
            path = self.file(sequence)
            if path.name.endswith(".seq.nrrd"):
                value = header(path)["axis 0 index values"].split()[item]
                continue
            fields = dict(line.split(" = ", 1) for line in path.read_text().splitlines())
            stamps = [float(v) for k, v in fields.items() if k.endswith("_Timestamp")]
            chosen = int(np.argmin(np.abs(np.array(stamps) - float(value))))
            (name,) = [k for k in fields if re.fullmatch(rf"Seq_Frame0*{chosen}_\w+Transform", k)]
            self.matrices[shown] = np.array(fields[name].split(), dtype=float).reshape(4, 4)
        return value


def header(path: Path) -> dict[str, str]:
    text = path.read_bytes().split(b"\n\n")[0].decode()
    return dict(re.split(r":=|: ", line, maxsplit=1) for line in text.splitlines()[1:])


def moved(matrix: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    return np.asarray(xyz @ matrix[:3, :3].T + matrix[:3, 3])


def ras(mr_mm: np.ndarray) -> np.ndarray:
    return mr_mm * (-1, -1, 1)


def bright_in_mr(t_s: float, pose: Rigid) -> np.ndarray:
    in_probe = PROBE_FROM_IMAGE.rigid.rotation @ (BRIGHT[0] * 0.3, BRIGHT[1] * 0.4, 0.0) + (5.0, 6.0, 7.0)
    turn, shift = pose_at(t_s)
    return pose.rotation @ (turn @ in_probe + shift) + pose.translation_mm


def image_ras(path: Path) -> np.ndarray:
    """Voxels to the node's own coordinates, as Slicer reads an image."""
    image = SimpleITK.ReadImage(str(path))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    matrix[:3, 3] = image.GetOrigin()
    return np.asarray(FLIP @ matrix)


def test_touched_landmarks_lie_on_those_of_the_mr(folder: Path) -> None:
    slicer = Slicer(folder)
    touched, told = slicer.points("landmarks_touched")
    marked, _ = slicer.points("landmarks_mr")
    np.testing.assert_allclose(touched, ras(FIRST.apply_array(TOUCHED)), atol=1e-9)
    np.testing.assert_allclose(touched, marked, atol=1e-9)
    assert told == ["registration error below 3.2 mm with 95 % probability"] * 2


@pytest.mark.parametrize(
    ("item", "number", "pose"), [(0, 0, FIRST), (3, 4, FIRST), (4, 5, LATER), (5, 7, LATER), (6, 8, LATER)]
)
def test_the_bright_pixel_of_a_frame_lies_at_its_place_in_the_mr(
    folder: Path, item: int, number: int, pose: Rigid
) -> None:
    """Frame 3 has no image, at frame 6 the pose was suspended, and frame 9 has no pose LAG_S later."""
    slicer = Slicer(folder)
    value = slicer.play(item)
    assert float(value) == pytest.approx(number / 10.0 + LAG_S, abs=1e-9)
    node = slicer.named("ultrasound")
    frames = SimpleITK.ReadImage(str(folder / "ultrasound.seq.nrrd"))
    assert frames.GetNumberOfComponentsPerPixel() == 7
    pixels = SimpleITK.GetArrayFromImage(frames)[..., item]
    (at,) = np.argwhere(pixels)
    assert pixels[tuple(at)] == 50 + number
    column_row = at[::-1].astype(float)
    assert tuple(column_row) == (*BRIGHT, 0.0)
    for file in (folder / "ultrasound.seq.nrrd", slicer.file(node)):
        place = moved(slicer.to_world(node) @ image_ras(file), column_row[None])[0]
        np.testing.assert_allclose(place, ras(bright_in_mr(number / 10.0 + LAG_S, pose)), atol=1e-9)


def test_the_tip_follows_the_tool(folder: Path) -> None:
    slicer = Slicer(folder)
    slicer.play(5)
    turn, shift = pose_at(0.7)
    expected = LATER.rotation @ (turn @ TIP[0] + shift) + LATER.translation_mm
    np.testing.assert_allclose(slicer.points("tool_tip")[0][0], ras(expected), atol=1e-9)


def test_mr_and_surfaces_lie_where_they_were(folder: Path) -> None:
    open3d = pytest.importorskip("open3d", reason="Open3D reads the meshes independently")
    slicer = Slicer(folder)
    assert "transform" not in slicer.references(slicer.named("mr"))
    image = SimpleITK.ReadImage(str(folder / "mr.mha"))
    np.testing.assert_allclose(
        image.TransformIndexToPhysicalPoint((4, 0, 2)), MR_GRID.to_mm(np.array([4.0, 0, 2]))
    )
    cycle = SimpleITK.ReadImage(str(folder / "mr.seq.nrrd"))
    np.testing.assert_allclose(
        cycle.TransformIndexToPhysicalPoint((4, 0, 2)), MR_GRID.to_mm(np.array([4.0, 0, 2]))
    )
    assert cycle[4, 0, 2] == (4 * 42 + 2, 210 + 4 * 42 + 2)
    assert header(folder / "mr.seq.nrrd")["axis 0 index values"] == "0.000 0.500"
    shown = [slicer.named(f"heart_{i:03d}") for i in range(4)]
    visible = [slicer.nodes[slicer.references(n)["display"]].attrib["visibility"] for n in shown]
    assert visible == ["true", "false", "false", "false"]
    for node, surface in zip(shown, ball_model().reference, strict=True):
        mesh = open3d.io.read_triangle_mesh(str(slicer.file(node)))
        np.testing.assert_allclose(np.asarray(mesh.vertices), surface.vertices_mm, atol=1e-4)
        assert b"SPACE=LPS" in slicer.file(node).read_bytes()[:80]


def test_a_changed_heart_is_shown_where_the_patient_has_it(tmp_path: Path) -> None:
    """Moved by 3 mm to the left: further out there, further in on the right, in place between."""
    outer = tuple(Mesh("mr", *sphere(20.0, 3, np.zeros(3))) for _ in range(4))
    caps = tuple(np.zeros(len(mesh.triangles), dtype=bool) for mesh in outer)
    model, origin = replace(ball_model(), reference=outer, reference_caps=caps), np.full(3, -60.0)
    moved_mm = np.tile([3.0, 0.0, 0.0], (13**3, 1))
    warp = Warp.through("mr", origin, 10.0, moved_mm, np.full(13**3, 0.25))
    write_slicer_scene(replace(run_folder(), warp=warp), model, tmp_path)
    slicer = Slicer(tmp_path)
    for part, side in (("further_out", 1.0), ("further_in", -1.0)):
        mesh = read_mesh(slicer.file(slicer.named(f"heart_now_{part}")))
        assert (side * (mesh.vertices_mm[:, 0] - 3.0) > 0.0).all()
    assert slicer.named("heart_now_in_place") is not None
    assert "heart_now_further_out.stl" in (tmp_path / "README.md").read_text()


def test_labels_are_segments_with_names_and_properties_as_the_patient_has_them(tmp_path: Path) -> None:
    """A slab of myocardium, moved by 3 mm to the left."""
    values = np.zeros((9, 5, 5), dtype=np.uint8)
    values[2:4], values[4:6] = 1, 2
    labels = Volume(Grid.axis_aligned("mr", values.shape, [-6.0, -3.0, -3.0], 1.5), values)
    origin, model = np.full(3, -60.0), ball_model()
    still, moved_mm = np.zeros((13**3, 3)), np.tile([3.0, 0.0, 0.0], (13**3, 1))
    motion = Warp.through("mr", origin, 10.0, still, np.zeros(13**3))
    tissue = Tissue(labels, ((1, "lv_myocardium"), (2, "lv_blood")), (motion,) * model.phases)
    warp = Warp.through("mr", origin, 10.0, moved_mm, np.full(13**3, 0.25))
    write_slicer_scene(replace(run_folder(), warp=warp), replace(model, tissue=tissue), tmp_path)
    slicer = Slicer(tmp_path)
    file = slicer.file(slicer.named("labels"))
    shown = SimpleITK.ReadImage(str(file))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(shown).T[2:], values[:-2])
    assert shown.GetOrigin() == (-6.0, -3.0, -3.0)
    fields = header(file)
    assert (fields["Segment0_Name"], fields["Segment0_LabelValue"]) == ("lv myocardium", "1")
    assert "stiffness:0.075 N/mm (Villemain 2019, shear" in fields["Segment0_Tags"]
    assert "damping:0.15 N·s/m (assumed)" in fields["Segment0_Tags"]
    assert fields["Segment1_Tags"] == ""
    for identity, node in slicer.nodes.items():
        assert re.fullmatch(rf"vtkMRML{CLASSES[node.tag]}Node\d+", identity)
    assert "`labels.seg.nrrd`" in (tmp_path / "README.md").read_text()


def test_a_reference_marker_keeps_its_name(tmp_path: Path) -> None:
    """A lab's own sequence with ProbeToReference goes under ReferenceToRas."""
    run = run_folder()
    scenario = replace(run.scenario, tracked_against="reference", tool=None, landmarks_tracker=None)
    frames = write_slicer_scene(replace(run, scenario=scenario), ball_model(), tmp_path)
    assert frames["ReferenceToRas.seq.mha"] == "ras_from_reference"
    assert frames["ProbeToReference.tfm"] == "reference_from_probe"
    assert "ProbeToReference" in (tmp_path / "README.md").read_text()
    assert not {name for name in frames if "Tool" in name or "Tracker" in name}


CLASSES = {
    "LinearTransform": "LinearTransform",
    "LinearTransformSequenceStorage": "LinearTransformSequenceStorage",
    "MarkupsFiducial": "MarkupsFiducial",
    "MarkupsFiducialDisplay": "MarkupsFiducialDisplay",
    "MarkupsJsonStorage": "MarkupsJsonStorage",
    "Model": "Model",
    "ModelDisplay": "ModelDisplay",
    "ModelStorage": "ModelStorage",
    "Segmentation": "Segmentation",
    "SegmentationDisplay": "SegmentationDisplay",
    "SegmentationStorage": "SegmentationStorage",
    "Sequence": "Sequence",
    "SequenceBrowser": "SequenceBrowser",
    "TransformStorage": "TransformStorage",
    "Volume": "ScalarVolume",
    "VolumeArchetypeStorage": "VolumeArchetypeStorage",
    "VolumeDisplay": "ScalarVolumeDisplay",
    "VolumeSequenceStorage": "VolumeSequenceStorage",
}
"""GetNodeTagName of each class of node, by Slicer's sources."""


def test_every_node_is_one_that_slicer_knows(folder: Path) -> None:
    for identity, node in Slicer(folder).nodes.items():
        assert re.fullmatch(rf"vtkMRML{CLASSES[node.tag]}Node\d+", identity)


def test_every_reference_and_every_file_is_there(folder: Path) -> None:
    slicer = Slicer(folder)
    known = {"vtkMRMLColorTableNodeGrey", *slicer.nodes}
    named = set()
    for node in slicer.nodes.values():
        assert set(slicer.references(node).values()) <= known
        named |= {node.attrib["fileName"]} if "fileName" in node.attrib else set()
    assert named | {"scene.mrml", "README.md"} == {path.name for path in folder.iterdir()}
    told = (folder / "README.md").read_text()
    for name in named - {f"heart_{i:03d}.stl" for i in (1, 2)}:
        assert f"`{name}`" in told


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match=r"has no result\.json"):
        read_exported_run(tmp_path, recorded())
    (tmp_path / "result.json").write_text('{"moving_from_fixed": []}')
    with pytest.raises(InvalidInputError, match="pair of images"):
        read_exported_run(tmp_path, recorded())
    (tmp_path / "result.json").write_text('{"estimates": {}}')
    with pytest.raises(UnreadableFileError, match="damaged"):
        read_exported_run(tmp_path, recorded())
