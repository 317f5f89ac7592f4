"""Fixtures in YAML: every key reaches its value, two of them are composed, and what is wrong is named."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from toy_ball import structure

from dvf_ig.core import DvfModel, InvalidInputError, Landmarks, Points, Rigid, UnreadableFileError
from dvf_ig.guidance import (
    Confinement,
    Contribution,
    Evaluator,
    FixtureOptions,
    Fixtures,
    Gaussian,
    PathFixture,
    PathTarget,
    Sigmoid,
    compose,
)
from dvf_ig.guidance.margins import MarginOptions
from dvf_ig.intake.fixtures import (
    FixturesConfig,
    ForbiddenConfig,
    GuidanceConfig,
    PathConfig,
    fixture_options,
    read_fixtures,
    structure_files,
)
from dvf_ig.intake.schema import SessionConfig
from dvf_ig.intake.session import session_fixtures
from dvf_ig.intake.session_log.live import LiveDocument, live_document
from dvf_ig.io import write_landmarks, write_model
from dvf_ig.io.json_file import read_json, write_json
from dvf_ig.io.yaml_config import read_yaml

CURVE = np.array([[-8.0, 0.0, 12.0], [0.0, 3.0, 15.0], [9.0, 1.0, 11.0]])


@pytest.fixture
def curve(tmp_path: Path) -> Path:
    """A curve beside the YAML file, stored as Slicer may: RAS."""
    path = tmp_path / "incision.mrk.json"
    write_landmarks(Landmarks(("a", "b", "c"), Points("mr", CURVE * [-1, -1, 1])), path)
    text = path.read_text(encoding="utf-8").replace('"LPS"', '"RAS"').replace("Fiducial", "Curve")
    path.write_text(text, encoding="utf-8")
    return path


def written(folder: Path, text: str) -> Path:
    path = folder / "fixtures.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key_reaches_its_value(tmp_path: Path, curve: Path) -> None:
    path = written(
        tmp_path,
        """
cap_n: 0.8
retiming: uniform
fixtures:
  - {law: forbidden, name: epicardium, gamma: 2, cap_n: 0.5, depth_mm: 5.0, blend: distance}
  - {law: forbidden, inside: true, gamma: 1.5}
  - {law: guidance, delta: 4.0, m: 2, cap_n: 0.4, depth_mm: -1, blend: periodic}
  - {law: path, delta: 2.5, m: 0.5, cap_n: 0.3, name: line, path: [[0, 0, 1], [0.0, 0.0, 2.0]]}
  - {law: path, path: incision.mrk.json}
""",
    )
    options, retiming = read_fixtures(path)
    assert retiming == "uniform"
    assert options.cap_n == 0.8
    wall, chamber, guide, line, incision = options.fixtures
    assert wall == FixtureOptions(Sigmoid(2.0, 0.5, 5.0), "distance", name="epicardium")
    assert chamber == FixtureOptions(Confinement(1.5))
    assert guide == FixtureOptions(Gaussian(4.0, 2.0, 0.4, -1.0), "periodic")
    assert (line.law, line.name) == (Gaussian(2.5, 0.5, 0.3), "line")
    assert line.path is not None
    assert line.path.frame == "mr"
    np.testing.assert_array_equal(line.path.points_mm, [[[0, 0, 1], [0, 0, 2]]])
    assert incision.law == Gaussian()
    assert incision.path is not None
    np.testing.assert_allclose(incision.path.points_mm[0], CURVE, atol=1e-12)


def test_the_guide_s_example_is_read(tmp_path: Path, curve: Path) -> None:
    page = Path(__file__).resolve().parents[2] / "dvf_ig/docs/guide/own-recordings.md"
    examples = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    example, further = (text for text in examples if "law: path" in text)
    options, retiming = read_fixtures(written(tmp_path, example))
    assert (options.cap_n, retiming) == (0.6, "two-segment")
    assert options.fixtures[0] == FixtureOptions(Sigmoid(depth_mm=2.0), name="epicardium")
    assert options.fixtures[1].law == Gaussian(4.0)
    config = FixturesConfig.model_validate(read_yaml(written(tmp_path, further), "fixtures"))
    assert [one.model for one in config.fixtures] == ["left_atrium.npz", "oesophagus.npz"]


def test_defaults_are_those_of_the_values(tmp_path: Path) -> None:
    assert ForbiddenConfig().options() == FixtureOptions()
    assert ForbiddenConfig(inside=True).options().law == Confinement()
    assert GuidanceConfig().options() == FixtureOptions(Gaussian())
    assert PathConfig(path=((0, 0, 0), (1, 0, 0))).options().law == Gaussian()
    assert FixturesConfig().fixture_set(tmp_path).fixtures == (FixtureOptions(),)
    assert fixture_options({"law": "guidance", "m": 2.0}) == FixtureOptions(Gaussian(m=2.0))


@pytest.mark.parametrize(
    "one",
    [
        FixtureOptions(Sigmoid(2.0, 0.5, 1.0), "distance", name="wall"),
        FixtureOptions(Confinement(1.5, depth_mm=-2.0)),
        FixtureOptions(Gaussian(4.0, 2.0, 0.4, 1.0), "periodic"),
    ],
)
def test_a_fixture_is_described_by_the_keys_that_make_it(one: FixtureOptions) -> None:
    assert fixture_options(one.described()) == one
    path = PathTarget.static("mr", CURVE)
    of_path = FixtureOptions(Gaussian(4.0), path=path, name="incision").described()
    again = fixture_options({**of_path, "path": CURVE.tolist()})
    assert (again.law, again.name) == (Gaussian(4.0), "incision")


def test_two_fixtures_are_what_compose_makes_of_them(ball: DvfModel, tmp_path: Path, curve: Path) -> None:
    path = written(
        tmp_path,
        """
fixtures:
  - {law: forbidden, name: epicardium, cap_n: 0.5}
  - {law: path, delta: 4.0, path: incision.mrk.json}
""",
    )
    options, retiming = read_fixtures(path)
    assert retiming is None
    pose = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
    points = np.random.default_rng(3).normal(size=(40, 3)) * [8.0, 5.0, 3.0] + [0.0, 0.0, 13.0]
    phase = np.linspace(0.0, 1.0, len(points))
    tip = pose.inverse().apply_array(points)
    got = Fixtures(ball, options).evaluate(pose, tip, phase)
    wall = Evaluator(ball, Sigmoid(1.0, 0.5)).force(points, phase)
    guide = PathFixture(PathTarget.static("mr", CURVE), Gaussian(4.0)).force(points, phase)
    by_hand = [
        compose([Contribution("mr", w, 0.5)], [Contribution("mr", g, 0.6)], frame="mr", cap_n=0.6)
        for w, g in zip(wall.force_n, guide.force_n, strict=True)
    ]
    expected = np.array([c.force_n for c in by_hand])
    np.testing.assert_allclose(got.force_n @ pose.rotation.T, expected, atol=1e-9)
    assert got.conflict.tolist() == [c.conflict for c in by_hand]
    np.testing.assert_allclose(got.distance_mm, wall.distance_mm, atol=1e-9)
    assert np.linalg.norm(expected - wall.force_n, axis=1).max() > 0.05


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("fixtures: [", "is not YAML"),
        ("", "needed keys with their values"),
        ("fixtures: []", "holds no fixture; needed at least one"),
        ("fixture: []", "unknown key fixture; needed some of fixtures, cap_n, retiming"),
        ("fixtures: [{gamma: 1.0}]", "fixtures.0: its 'law' is missing"),
        ("fixtures: [{law: sigmoid}]", "fixtures.0.law is 'sigmoid'; needed 'forbidden', 'guidance', 'path'"),
        (
            "fixtures: [{law: guidance, gamma: 2.0}]",
            "fixtures.0: unknown key gamma; needed some of name, cap_n, model, law, delta, m, depth_mm",
        ),
        ("fixtures: [{law: forbidden}, {law: guidance, delta: wide}]", "fixtures.1.delta: needed a number"),
        ("fixtures: [{law: forbidden, gamma: true}]", "fixtures.0.gamma: needed a number"),
        ("fixtures: [{law: forbidden, cap_n: .nan}]", "fixtures.0.cap_n: .*finite"),
        (
            "fixtures: [{law: forbidden, blend: nearest}]",
            "fixtures.0.blend: .*'force', 'distance' or 'period",
        ),
        ("fixtures: [{law: forbidden, gamma: -1}]", "fixtures.0: sigmoid steepness gamma_per_mm is -1"),
        ("fixtures: [{law: path}]", "fixtures.0.path: it is missing"),
        ("fixtures: [{law: path, path: [[0, 0], [1, 1]]}]", r"fixtures.0.path: needed points \[\[x, y, z\]"),
        ("fixtures: [{law: path, path: [[0, 0, 0]]}]", "fixtures.0: .*at least 2 points"),
        (
            "fixtures: [{law: path, path: no.mrk.json}]",
            r"fixtures.0: .*no.mrk.json does not exist; needed 3D Sl",
        ),
        ("retiming: linear", "retiming: .*'uniform' or 'two-segment'"),
        ("cap_n: -1.0", "joint cap is -1 N"),
        ("cap_n: 1000", "the joint cap is 1000 N; no device holds more than 20 N"),
        ("cap_n: 4.5", "the joint cap is 4.5 N; at most 4 N is allowed where no stronger device is named"),
        (
            "fixtures: [{law: forbidden, name: wall, cap_n: 5}]",
            "fixture 'wall': force cap cap_n is 5 N; at most",
        ),
        (
            "fixtures: [{law: forbidden, gamma: 0.001}]",
            "fixtures.0: .* felt 4595 mm from the organ's surface",
        ),
        (
            "fixtures: [{law: forbidden, depth_mm: -40}]",
            "fixtures.0: .* felt 44.6 mm from the organ's surface",
        ),
        ("device: {name: omega.3}", "device.continuous_force_n: it is missing"),
        ("device: {name: '', continuous_force_n: 9}", "device.name: it is empty"),
        (
            "device: {name: omega.3, continuous_force_n: 40}",
            "continuous_force_n is 40 N; no device holds more",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_file_and_key(tmp_path: Path, text: str, complaint: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UnreadableFileError, match=complaint) as raised:
        read_fixtures(path)
    message = str(raised.value)
    assert message.startswith(str(path))
    assert "\n" not in message


def test_a_file_of_two_curves_is_refused(tmp_path: Path, curve: Path) -> None:
    document = read_json(curve)
    document["markups"] *= 2
    write_json(curve, document)
    path = written(tmp_path, "fixtures: [{law: path, path: incision.mrk.json}]")
    with pytest.raises(UnreadableFileError, match="holds 2 markups; needed one, the curve"):
        read_fixtures(path)


def test_an_absent_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match=r"nowhere\.yaml does not exist; needed a description of"):
        read_fixtures(tmp_path / "nowhere.yaml")


def test_a_number_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="exponent m is 0"):
        fixture_options({"law": "guidance", "m": 0.0})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("off", MarginOptions()),
        ("adaptive", MarginOptions("adaptive")),
        ("fixed", MarginOptions("fixed")),
        ("1.5", MarginOptions("fixed", fixed_mm=1.5)),
    ],
)
def test_a_margin_is_a_mode_or_a_width(tmp_path: Path, text: str, expected: MarginOptions) -> None:
    """YAML's bare `off` is false."""
    found, _ = read_fixtures(written(tmp_path, f"margin: {text}\nfixtures: [{{law: forbidden}}]\n"))
    assert found.margin == expected
    with pytest.raises(UnreadableFileError, match="margin: needed off, fixed, adaptive, or a number of mm"):
        read_fixtures(written(tmp_path, "margin: wide\n"))
    with pytest.raises(InvalidInputError, match="between 0 and the cap"):
        read_fixtures(written(tmp_path, "margin: 9\n"))


@pytest.mark.parametrize(
    "text", ["margin: 0.002\nfixtures: [{law: forbidden}]", "fixtures: [{law: forbidden, depth_mm: -0.004}]"]
)
def test_a_margin_or_depth_in_m_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(
        UnreadableFileError, match=r"0\.00\d mm is no depth or margin of tissue; it may be in m"
    ):
        read_fixtures(written(tmp_path, f"{text}\n"))


def test_a_device_is_stated_with_the_fixtures(tmp_path: Path) -> None:
    device = "device: {name: omega.3, continuous_force_n: 12, stiffness_n_per_m: 3000}"
    path = written(tmp_path, f"{device}\ncap_n: 11.0\nfixtures: [{{law: guidance, delta: 20, cap_n: 12}}]\n")
    options = read_fixtures(path)[0]
    assert (options.device.name, options.device.continuous_force_n, options.joint_cap_n) == (
        "omega.3",
        12.0,
        11.0,
    )
    assert options.device.stiffness_n_per_m == 3000.0


def test_a_joint_cap_of_a_session_holds_without_a_list_of_fixtures(tmp_path: Path) -> None:
    """It was read and left out: 0.6 N, or what a file of fixtures said."""
    document = {"ultrasound": "a.mha", "cap_n": 0.2}
    options, _ = session_fixtures(SessionConfig.model_validate(document), tmp_path, "session.yaml")
    assert options is not None
    assert (options.joint_cap_n, options.fixtures) == (0.2, (FixtureOptions(),))
    document["fixtures"] = "fixtures.yaml"
    written(tmp_path, "fixtures: [{law: forbidden}]\n")
    with pytest.raises(
        UnreadableFileError, match=r"cap_n belongs in fixtures\.yaml, which describes the fixtures"
    ):
        session_fixtures(SessionConfig.model_validate(document), tmp_path, "session.yaml")
    del document["cap_n"]
    options, _ = session_fixtures(SessionConfig.model_validate(document), tmp_path, "session.yaml")
    assert options is not None
    assert options.joint_cap_n == 0.6


def test_structures_and_beating_paths_are_read_and_logged_with_their_models(
    tmp_path: Path, ball: DvfModel
) -> None:
    """From YAML, and from a live session's log: equal fixtures, each model once."""
    for name, model in {
        "atrium": structure("atrium", [18.0, 4.0, 0.0], 8.0),
        "oesophagus": structure("oesophagus", [30.0, 4.0, 0.0], 5.0, still=True),
    }.items():
        write_model(model, tmp_path / f"{name}.npz")
    text = """
fixtures:
  - {law: path, delta: 4.0, path: [[26.0, 4.0, 0.0], [25.0, 7.0, 2.0]], model: atrium.npz}
  - {law: guidance, cap_n: 0.3, model: atrium.npz}
  - {law: forbidden, name: oesophagus, cap_n: 0.3, model: oesophagus.npz}
  - {law: forbidden, cap_n: 0.3}
"""
    options, _ = read_fixtures(written(tmp_path, text))
    line, pull, wall, heart = options.fixtures
    assert line.structure is pull.structure
    assert line.structure is not None
    assert wall.structure is not None
    assert (line.structure.surface_name, wall.structure.surface_name) == ("atrium", "oesophagus")
    assert line.path is not None
    assert line.path.timing is not None
    assert heart.structure is None
    assert Fixtures(ball, options).parts
    files = structure_files(options)
    assert list(files) == ["structure-0.npz", "structure-1.npz"]
    log = tmp_path / "log"
    log.mkdir()
    for file, model in files.items():
        write_model(model, log / file)
    content = json.loads(live_document(options, "uniform", 3))
    back = LiveDocument.model_validate(content).fixtures.fixture_set(log)
    for one, other in zip(back.fixtures, options.fixtures, strict=True):
        assert one.described() == other.described()
        if one.path is not None and other.path is not None:
            np.testing.assert_array_equal(one.path.points_mm, other.path.points_mm)
        if one.structure is not None and other.structure is not None:
            np.testing.assert_array_equal(one.structure.coefficients, other.structure.coefficients)
    with pytest.raises(UnreadableFileError, match=r"fixtures\.0: .*nowhere\.npz"):
        read_fixtures(written(tmp_path, "fixtures: [{law: forbidden, model: nowhere.npz}]\n"))


def test_the_tool_block_of_a_session_gives_the_tool(tmp_path: Path) -> None:
    """Beside poses of the tool, without any, and in a file of fixtures, whose tool the session's replaces."""
    stated = {
        "diameter_mm": 5.0,
        "shaft_mm": 60.0,
        "fulcrum": {"point_mm": [10.0, 20.0, 30.0], "length_mm": 350.0},
    }
    for poses in ({}, {"file": "tool.igs.mha"}):
        fixtures, _ = session_fixtures(SessionConfig(tool=poses | stated), tmp_path, "session.yaml")
        assert fixtures is not None
        assert (fixtures.tool.diameter_mm, fixtures.tool.shaft_mm) == (5.0, 60.0)
        assert fixtures.tool.fulcrum is not None
        np.testing.assert_array_equal(fixtures.tool.fulcrum.point_mm, [10.0, 20.0, 30.0])
    assert session_fixtures(SessionConfig(tool="tool.igs.mha"), tmp_path, "session.yaml")[0] is None
    (tmp_path / "fixtures.yaml").write_text("fixtures: [{law: forbidden}]\ntool: {diameter_mm: 3}\n")
    assert read_fixtures(tmp_path / "fixtures.yaml")[0].tool.diameter_mm == 3.0
    both = SessionConfig(fixtures="fixtures.yaml", tool={"diameter_mm": 8.0})
    fixtures, _ = session_fixtures(both, tmp_path, "session.yaml")
    assert fixtures is not None
    assert fixtures.tool.diameter_mm == 8.0
    for wrong, message in (
        ({"shaft_mm": 10.0}, "direction of the tool's shaft"),
        ({"diameter_mm": 99.0}, "diameter is 99 mm"),
    ):
        with pytest.raises(UnreadableFileError, match=message):
            session_fixtures(SessionConfig(tool=wrong), tmp_path, "session.yaml")
    with pytest.raises(ValueError, match="file in which it is recorded"):
        SessionConfig(tool={"name": "Needle"})
