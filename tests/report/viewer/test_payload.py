"""What a page is given: packed numbers, surfaces through the cycle, fields that its description names."""

import base64
import gzip
import hashlib
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from toy_ball import CENTERS, RADII, structure
from toy_session import TIP, compare_known, register_known, run, ticks, toy_setup, toy_streams
from toy_sphere import sphere

import dvf_ig
from dvf_ig.core import (
    Chamber,
    DvfModel,
    Grid,
    InvalidInputError,
    Landmarks,
    Mesh,
    PhaseState,
    Points,
    Tissue,
    Volume,
    Warp,
)
from dvf_ig.core.space.warp import knots
from dvf_ig.guidance import (
    Confinement,
    Evaluator,
    FixtureOptions,
    FixtureSet,
    Gaussian,
    Hazard,
    Sigmoid,
    Status,
    SupervisorState,
    Tool,
)
from dvf_ig.report.viewer import (
    SceneInput,
    frame_event,
    image_shape,
    live_page,
    model_payload,
    packed,
    scene_payload,
    state_event,
    viewer_html,
)
from dvf_ig.report.viewer.model import MODEL_STEP_S
from dvf_ig.report.viewer.page import SLOT
from dvf_ig.report.viewer.scene import heart_payload, labels_payload, words
from dvf_ig.report.viewer.series import STEPS
from dvf_ig.report.viewer.surfaces import cycle_surface, fixture_surface, shown_level_mm
from dvf_ig.session import Session

WEB = Path(dvf_ig.__file__).parent / "report" / "web"


def unpacked(entry: dict[str, Any]) -> np.ndarray:
    """As README.md tells a page to do it."""
    kind = np.dtype(entry["dtype"])
    shuffled = np.frombuffer(gzip.decompress(base64.b64decode(entry["data"])), np.uint8)
    flat = shuffled.reshape(kind.itemsize, -1).T.copy().view(kind.newbyteorder("<")).reshape(entry["shape"])
    if kind.kind != "i":
        return flat
    if entry["delta"]:
        flat = np.cumsum(flat, axis=0, dtype=kind)
    values = entry["offset"] + entry["scale"] * flat.astype(np.float64)
    return np.where(flat == np.iinfo(kind).min, np.nan, values)


@pytest.fixture(scope="module")
def round_ball(ball: DvfModel) -> DvfModel:
    """The ball with its surface, whose triangles differ from phase to phase, and a chamber within."""
    centers = zip(RADII, CENTERS, (4, 3, 4, 4), strict=True)
    outer = tuple(Mesh("mr", *sphere(radius, n, center)) for radius, center, n in centers)
    inner = tuple(
        Mesh("mr", *sphere(radius / 2, 3, center)) for radius, center in zip(RADII, CENTERS, strict=True)
    )
    caps = tuple(np.zeros(len(mesh.triangles), dtype=bool) for mesh in outer)
    return replace(ball, reference=outer, reference_caps=caps, chambers=(Chamber("lv_blood", inner),))


@given(
    arrays(np.float64, array_shapes(max_dims=3, max_side=6), elements=st.floats(-2e5, 2e5) | st.just(np.nan)),
    st.sampled_from([1.0, 0.02, 1e-4]),
    st.booleans(),
)
def test_packed_numbers_come_back_to_half_a_step(values: np.ndarray, scale: float, delta: bool) -> None:
    np.testing.assert_allclose(unpacked(packed(values, scale, delta=delta)), values, atol=0.501 * scale)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="does not fit"):
        packed(np.array([3e4]), 1e-6)


def test_vertices_lie_on_the_surface_of_every_phase(round_ball: DvfModel) -> None:
    surface = cycle_surface(round_ball.reference, 3.0)
    assert surface.vertices_mm.shape[0] == round_ball.phases
    assert 100 < len(surface.vertices_mm[0]) < len(round_ball.reference[0].vertices_mm) / 2
    assert set(surface.triangles.ravel()) == set(range(surface.vertices_mm.shape[1]))
    for vertices, center, radius in zip(surface.vertices_mm, CENTERS, RADII, strict=True):
        np.testing.assert_allclose(np.linalg.norm(vertices - center, axis=1), radius, atol=0.25)


@pytest.mark.parametrize("level", [-2.2, 0.0, 3.0])
def test_a_fixture_is_shown_at_its_distance(ball: DvfModel, round_ball: DvfModel, level: float) -> None:
    organ = cycle_surface(round_ball.reference, 3.0)
    shown = fixture_surface(organ, Evaluator(ball, Sigmoid()), level)
    for i in (0, 3):
        field = Evaluator(ball, Sigmoid()).force(shown.vertices_mm[i], ball.timing.fractions[i])
        np.testing.assert_allclose(field.distance_mm, level, atol=0.02)


@pytest.mark.parametrize("law", [Sigmoid(2.0, 0.5, 1.0), Confinement(0.7, 0.6, -1.0)])
def test_a_wall_is_shown_where_its_force_is_a_tenth_of_the_cap(law: Sigmoid | Confinement) -> None:
    assert abs(law.potential(np.array([shown_level_mm(law)]))[0]) == pytest.approx(0.1)


def test_guidance_is_shown_at_its_aim() -> None:
    assert shown_level_mm(Gaussian(depth_mm=1.5)) == 1.5


def test_codes_of_states_are_places_in_their_lists() -> None:
    told = words()
    assert [Status(i).name.lower() for i in range(len(Status))] == told["status"]
    assert [SupervisorState(i).name.lower() for i in range(len(SupervisorState))] == told["supervisor"]
    assert [1 << i for i in range(len(told["hazards"]))] == [
        int(Hazard[h["name"].upper()]) for h in told["hazards"]
    ]


@pytest.fixture(scope="module")
def scene(round_ball: DvfModel) -> dict[str, Any]:
    targets = Landmarks(("apex",), Points("mr", np.array([[1.0, 2.0, 3.0]])))
    shape = image_shape(300, 400, (0.5, 0.4), None, 200)
    fixtures = FixtureSet((FixtureOptions(), FixtureOptions(Gaussian(), name="aim")))
    model = replace(round_ball, tissue=tissue(round_ball.phases))
    return scene_payload(SceneInput("live", "toy", model, fixtures, shape, ("II", "mV"), targets=targets))


def tissue(phases: int) -> Tissue:
    """Myocardium and blood, carried 2 mm further to the left in each phase."""
    values = np.zeros((4, 5, 6), dtype=np.uint8)
    values[1], values[2] = 1, 200
    places = knots(CENTERS[0] - 60.0, 10.0)
    motion = tuple(
        Warp.through(
            "mr", CENTERS[0] - 60.0, 10.0, np.tile([2.0 * k, 0, 0], (len(places), 1)), np.zeros(len(places))
        )
        for k in range(phases)
    )
    labels = Volume(Grid.axis_aligned("mr", values.shape, CENTERS[0], 1.5), values)
    return Tissue(labels, ((1, "lv_myocardium"), (200, "lv_blood")), motion)


def test_labels_come_with_their_motion_and_what_is_assumed_of_them(scene: dict[str, Any]) -> None:
    labels, given_tissue = scene["labels"], tissue(4)
    np.testing.assert_array_equal(unpacked(labels["values"]), given_tissue.labels.values)
    shifts_mm = unpacked(labels["motion"]["coefficients_mm"])
    for shift_mm, warp in zip(shifts_mm, given_tissue.motion, strict=True):
        np.testing.assert_allclose(shift_mm, warp.coefficients[..., :3], atol=0.051)
    wall, blood = labels["kinds"]
    assert (wall["name"], wall["tissue"]) == ("lv_myocardium", "myocardium")
    stiffness, damping = wall["properties"][:2]
    assert stiffness[:2] == ["stiffness", "0.075 N/mm"]
    assert stiffness[2].startswith("Villemain 2019")
    assert damping == ["damping", "0.15 N·s/m", "assumed"]
    assert (blood["tissue"], blood["properties"]) == (None, [])
    assert labels["change"] is None


def test_every_field_stands_in_the_description(scene: dict[str, Any]) -> None:
    text = (WEB / "README.md").read_text()
    names = {*scene, *scene["heart"], *scene["distance"], *scene["image"], *scene["words"], *STEPS}
    names |= {*scene["labels"], *scene["labels"]["kinds"][0], *scene["labels"]["motion"]}
    names |= {*scene["heart"]["surfaces"][0], *scene["heart"]["surfaces"][-1], *scene["fixtures"][0]}
    names -= {name for name in STEPS if "_y_" in name or "_z_" in name or name.endswith(("_y", "_z"))}
    assert not [name for name in names if name not in text]
    json.dumps(scene, allow_nan=False)


def test_further_structures_are_shown_with_their_walls(round_ball: DvfModel) -> None:
    """Once each, in as many phases as the heart; a wall at its distance from its own structure."""
    atrium = structure("atrium", [30.0, 4.0, 0.0], 8.0)
    still = structure("oesophagus", [45.0, 4.0, 0.0], 5.0, still=True)
    walls = tuple(FixtureOptions(Sigmoid(cap_n=0.2), structure=one) for one in (atrium, still, still))
    shown = heart_payload(round_ball, FixtureSet((FixtureOptions(), *walls)))["surfaces"]
    assert [one["name"] for one in shown if one["role"] == "organ"] == ["EPICARDIAL"]
    assert [one["name"] for one in shown if one["role"] == "structure"] == ["atrium", "oesophagus"]
    fixtures = {one["fixture"]: unpacked(one["vertices"]) for one in shown if one["role"] == "fixture"}
    assert list(fixtures) == [0, 1, 2, 3]
    level_mm = shown_level_mm(Sigmoid())
    for phase, (radius, center) in enumerate(zip(RADII * 0.5, CENTERS, strict=True)):
        away_mm = np.linalg.norm(fixtures[1][phase] - center - [30.0, 4.0, 0.0], axis=1)
        np.testing.assert_allclose(away_mm, radius - level_mm, atol=0.1)
        away_mm = np.linalg.norm(fixtures[3][phase] - [45.0, 4.0, 0.0], axis=1)
        np.testing.assert_allclose(away_mm, 5.0 - level_mm, atol=0.1)


def test_a_changed_heart_is_shown_as_the_patient_has_it(round_ball: DvfModel) -> None:
    """Moved by 3 mm to the left, and not known on its right side."""
    origin = CENTERS[0] - 60.0
    places = knots(origin, 10.0)
    variance = np.where(places[:, 0] > CENTERS[0][0], 0.25, 4.0)
    moved_mm = np.array([3.0, 0.0, 0.0])
    warp = Warp.through("mr", origin, 10.0, np.tile(moved_mm, (len(places), 1)), variance)
    organ, patient = heart_payload(round_ball, None, warp)["surfaces"][::2]
    assert (organ["role"], patient["role"]) == ("organ", "patient")
    before = unpacked(organ["vertices"])
    np.testing.assert_allclose(unpacked(patient["vertices"]) - before, moved_mm + 0.0 * before, atol=0.03)
    outward, right = unpacked(patient["outward_mm"]), before[0, :, 0] - CENTERS[0][0]
    expected = 3.0 * right / np.linalg.norm(before[0] - CENTERS[0], axis=1)
    np.testing.assert_allclose(outward[right > 10.0], expected[right > 10.0], atol=0.1)
    assert np.isnan(outward[right < -15.0]).all()


def test_a_heart_that_contracts_otherwise_is_shown_contracting_as_it_does(round_ball: DvfModel) -> None:
    places = knots(CENTERS[0] - 60.0, 10.0)
    still = Warp.through("mr", CENTERS[0] - 60.0, 10.0, np.zeros((len(places), 3)), np.zeros(len(places)))
    warp = replace(still, contraction=0.5)
    organ, patient = (
        unpacked(one["vertices"]) for one in heart_payload(round_ball, None, warp)["surfaces"][::2]
    )
    at_rest = organ[round_ball.rest_phase]
    np.testing.assert_allclose(patient - at_rest, 0.5 * (organ - at_rest), atol=0.03)
    assert np.abs(organ - at_rest).max() > 1.0
    moved, usual = (
        unpacked(labels_payload(tissue(4), one)["motion"]["coefficients_mm"]) for one in (warp, None)
    )
    np.testing.assert_allclose(moved, 0.5 * usual, atol=0.051)


def test_the_distance_of_the_scene_is_the_models(scene: dict[str, Any], ball: DvfModel) -> None:
    given_field = scene["distance"]
    values = unpacked(given_field["values"])
    places = np.argwhere(np.abs(values[3]) < 8.0)[::97]
    points = np.array(given_field["origin_mm"]) + given_field["spacing_mm"] * places
    true = Evaluator(ball, Sigmoid()).force(points, ball.timing.fractions[3]).distance_mm
    np.testing.assert_allclose(values[3][tuple(places.T)], true, atol=0.051)


def test_a_smaller_image_shows_the_same_place() -> None:
    shape = image_shape(300, 400, (0.5, 0.4), None, 200)
    mr_from_recorded = np.array([[0.5, 0.0, 1.0], [0.0, 0.4, 2.0], [0.0, 0.0, 3.0]])
    image = np.zeros((300, 400), dtype=np.uint8)
    placed = np.array(frame_event(image, shape, 1.0, None, mr_from_recorded)["mr_from_pixel"])
    corner = [shape.columns - 0.5, shape.rows - 0.5, 1.0]
    np.testing.assert_allclose(placed @ corner, mr_from_recorded @ [399.5, 299.5, 1.0], atol=1e-5)
    assert shape.pixel_mm == pytest.approx((1.0, 0.8))
    assert frame_event(image, shape, 1.0, 0.5, None)["mr_from_pixel"] is None


def test_an_event_says_what_the_state_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
    with Session(toy_setup()) as session:
        states = run(session, toy_streams(13.0).merged(), [5.0, *ticks(12.6, 12.7)])
    early, state = state_event(states[0], Tool()), state_event(states[-1], Tool())
    assert list(state) == [*(name for name in STEPS if name not in ("status", "supervisor", "hazards")),
                           "status", "supervisor", "hazards"]  # fmt: skip
    assert early["tip_mr_x_mm"] is None
    assert early["pose_age_s"] is None
    assert "no_pose" in early["hazards"].split("|")
    last = states[-1]
    assert (state["t_s"], state["status"]) == (last.now_s, last.status.name.lower())
    assert state["phase_valid"] == (last.phase.state is PhaseState.LOCKED) == 1
    assert last.transform.pose is not None
    pose = last.transform.pose.at(last.now_s)
    tip = pose.apply_array(last.tool.tip_tracker_mm)
    np.testing.assert_allclose([state[f"tip_mr_{a}_mm"] for a in "xyz"], tip, atol=1e-4)
    force = [state[f"force_mr_{a}_n"] for a in "xyz"]
    np.testing.assert_allclose(force, pose.rotation @ last.force_n, atol=1e-5)
    shaft = np.array([state[f"shaft_mr_{a}"] for a in "xyz"])
    sensor = pose.apply_array(last.tool.tip_tracker_mm - last.tool.rotation @ TIP.xyz_mm[0])
    np.testing.assert_allclose(shaft * np.linalg.norm(TIP.xyz_mm[0]), sensor - tip, atol=0.2)


def test_the_page_that_ships_was_built_from_these_sources() -> None:
    names = ["index.html", "package.json", "package-lock.json", "vite.config.js"]
    names += [f"src/{path.name}" for path in (WEB / "src").iterdir()]
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(f"{name}\n".encode() + (WEB / name).read_bytes())
    assert f'<meta name="dvf-sources" content="{digest.hexdigest()}" />' in live_page(), (
        "dvf_ig/report/web/built/viewer.html is older than its sources; run scripts/viewer"
    )


@pytest.mark.skipif(
    shutil.which("npm") is None or not (WEB / "node_modules").is_dir(),
    reason="npm or dvf_ig/report/web/node_modules is missing: scripts/viewer installs them",
)
def test_the_page_builds_again_to_the_same_bytes(tmp_path: Path) -> None:
    build = ["npx", "vite", "build", "--logLevel", "warn", "--outDir", str(tmp_path), "--emptyOutDir"]
    subprocess.run(build, cwd=WEB, check=True, capture_output=True, timeout=120)
    assert (tmp_path / "viewer.html").read_text(encoding="utf-8") == live_page()


def test_the_page_forbids_itself_any_other_address() -> None:
    policy = live_page().split('http-equiv="Content-Security-Policy"')[1].split(">")[0]
    assert "default-src 'none'" in policy
    assert "connect-src 'self'" in policy
    assert "http" not in policy


def test_no_text_of_the_data_ends_the_element_that_holds_it() -> None:
    title = "</script><script>alert(1)</script> & <!--"
    page = viewer_html({"title": title, "x": 1.5})
    start = page.index(SLOT.removesuffix("</script>")) + len(SLOT.removesuffix("</script>"))
    assert json.loads(page[start : page.index("</script>", start)]) == {"title": title, "x": 1.5}
    assert "<title>&lt;/script&gt;" in page
    with pytest.raises(InvalidInputError, match="not finite"):
        viewer_html({"title": "", "x": np.nan})


def test_a_model_alone_beats_at_its_own_rate(round_ball: DvfModel) -> None:
    page = model_payload(round_ball)
    assert (page["kind"], page["image"], page["fixtures"]) == ("model", None, [])
    ticks = {name: unpacked(column) for name, column in page["series"]["ticks"].items() if name != "t_s"}
    period = round(round_ball.timing.rr_s / MODEL_STEP_S)
    phase = ticks["model_phase"][:period]
    np.testing.assert_allclose(phase, np.arange(period) * MODEL_STEP_S / round_ball.timing.rr_s, atol=1e-6)
    assert np.isnan(ticks["tip_mr_x_mm"]).all()
    assert ["phases", f"{round_ball.phases}, RR {round_ball.timing.rr_s:.2f} s"] in page["rows"]
    assert viewer_html(page).count("<title>") == 1
