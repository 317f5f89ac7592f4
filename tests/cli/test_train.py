"""`dvf-ig train`: a simulated operator plays in real time, its page shows it, its log and table name it."""

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fake_library import BUTTON, POSITION, SharedDhd, compiled
from toy_sphere import sphere
from typer.testing import CliRunner

from data_synth.operator.contact import MovingSurface
from dvf_ig.cli.main import app
from dvf_ig.core import CycleTiming, FloatArray, SurfaceSeries
from dvf_ig.guidance import Hazard, SupervisorState
from dvf_ig.guidance.devices import HeldDevice
from dvf_ig.guidance.servo import SentForce
from dvf_ig.preop import ModelOptions, model_from_surfaces
from dvf_ig.study.operators import closed_loop, pellets, practice
from dvf_ig.study.operators.closed_loop import NO_HAPTICS, OperatingHeart


class Ball:
    """Drawn back by up to 3 mm once a cycle."""

    def __init__(self) -> None:
        self.unit, self.surface_triangles = sphere(1.0, 3)

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return np.asarray(self.unit * (30.0 - 3.0 * np.sin(np.pi * model_phase) ** 2))


@pytest.fixture(scope="module")
def heart() -> OperatingHeart:
    ball, timing = Ball(), CycleTiming.uniform(8, 0.6)
    vertices = np.stack([ball.surface_vertices(phase) for phase in timing.fractions])
    series = SurfaceSeries("EPICARDIAL", "mr", vertices, ball.surface_triangles, timing, "ball")
    options = ModelOptions(knot_spacing_mm=5.0, margin_mm=16.0)
    return OperatingHeart(MovingSurface.of(ball), model_from_surfaces(series, options=options))


@pytest.fixture
def quick(heart: OperatingHeart, monkeypatch: pytest.MonkeyPatch) -> None:
    """One pellet, pushed in half a second."""
    monkeypatch.setattr(closed_loop, "operating_heart", lambda: heart)
    for module in (pellets, practice):
        monkeypatch.setattr(module, "PELLETS", 1)
    for name, seconds in (("DOWN_S", 0.3), ("UP_S", 0.2), ("HOLD_S", 0.1)):
        monkeypatch.setattr(pellets, name, seconds)


@pytest.mark.usefixtures("quick")
def test_a_simulated_operator_plays_both_arms_and_is_in_the_table(tmp_path: Path) -> None:
    command = ["train", "cutting", "--person", "nobody", "--sight", "anaglyph", "-o", str(tmp_path)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "see it at http://127.0.0.1:" in done.stderr
    assert "nobody, stereo" in done.stdout
    assert "4.92 ± 0.20" in done.stdout, "the paper's first person"
    lines = practice.read_log(tmp_path)
    assert {line["condition"] for line in lines} == {
        f"stereo, {arm}" for arm in ("visual only", "visual + haptic")
    }
    for line in lines:
        assert line["complete"]
        course = np.loadtxt(tmp_path / line["course"], delimiter=",", skiprows=1)
        assert course[:, 5].max() == pytest.approx(line["pellet_depths_mm"][0], abs=1e-3)
        assert (course[:, 4].max() == 0.0) == line["condition"].endswith(NO_HAPTICS)


@pytest.mark.usefixtures("quick")
def test_a_person_plays_with_a_vendor_s_device(
    heart: OperatingHeart, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fake device is pushed 7 to 10 mm into the heart, held for a beat, and drawn back; with force and
    without. Its trial begins where its button was pressed, not where the device was when it was opened."""
    library = compiled("fake_dhd", tmp_path, "libdhd.so")
    monkeypatch.setattr("dvf_ig.guidance.devices.force_dimension.LIBRARY", str(library))
    monkeypatch.delenv("FORCEDIM_SDK", raising=False)
    state = SharedDhd(tmp_path / "dhd", (0.0, 0.0, 0.0))
    monkeypatch.setenv("FAKE_DHD", str(state.path))
    loop, task = pellets.pellet_trial(heart, "cutting", closed_loop.Condition("", beating=False), 1)
    rotation = practice.place_of_device("force-dimension", loop, np.zeros(3)).rotation
    inwards = -rotation.T @ task.pellets.sites[0].normal

    aside_m, await_press = np.array([0.03, -0.02, 0.01]), practice.tip_at_press_mm

    def push() -> None:
        for share in np.minimum(2.0 * np.sin(np.linspace(0.0, np.pi, 1400)), 1.0):
            state.numbers[POSITION : POSITION + 3] = aside_m + 1e-3 * 18.0 * share * inwards
            time.sleep(0.001)

    pushes: list[threading.Thread] = []

    def tip_at_press_mm(device: HeldDevice) -> FloatArray:
        """Move the hand after the device was opened, press, and begin to push once the press was taken."""
        for before in pushes:
            before.join()
        state.numbers[BUTTON] = 0.0
        state.numbers[POSITION : POSITION + 3] = aside_m
        threading.Timer(0.1, state.numbers.__setitem__, (BUTTON, 1.0)).start()
        tip_mm = await_press(device)
        pushes.append(threading.Thread(target=push))
        pushes[-1].start()
        return tip_mm

    monkeypatch.setattr(practice, "tip_at_press_mm", tip_at_press_mm)
    command = ["train", "cutting", "--device", "force-dimension", "--person", "anna", "-o", str(tmp_path)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    forces = {line["condition"]: line["measures"]["largest_force_n"] for line in practice.read_log(tmp_path)}
    assert forces[f"mono, {NO_HAPTICS}"] < 1e-6
    assert 0.02 < forces["mono, visual + haptic"] <= 0.6
    assert all(6.5 < line["pellet_depths_mm"][0] < 10.5 for line in practice.read_log(tmp_path))


def test_an_unknown_device_exits_3_before_the_heart_is_prepared(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["train", "cutting", "--device", "simulated:falcon", "-o", str(tmp_path)])
    assert done.exit_code == 3
    assert "needed one of" in done.output
    assert "preparing" not in done.output


def test_the_order_of_the_arms_is_drawn_by_the_seed() -> None:
    first = {practice.Practice("cutting", seed=seed).arms(0)[0].haptic for seed in range(8)}
    assert first == {True, False}
    assert practice.Practice("cutting", seed=3).arms(1) == practice.Practice("cutting", seed=3).arms(1)


def test_a_vendor_s_axes_are_turned_to_the_view(heart: OperatingHeart) -> None:
    """Right, up and towards the person stay so: a proper rotation, the tip above the first pellet."""
    loop, _ = pellets.pellet_trial(heart, "cutting", closed_loop.Condition(""), 1)
    toward, up = practice.view_of(loop)
    for name, axes in practice.AXES.items():
        place = practice.place_of_device(name, loop, np.array([10.0, 20.0, 30.0]))
        np.testing.assert_allclose(place.apply_array(np.array([10.0, 20.0, 30.0])), loop.start_mm)
        assert np.linalg.det(place.rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(place.rotation[:, axes.index("toward")], toward)
        np.testing.assert_allclose(place.rotation[:, axes.index("up")], up)


def test_the_page_shows_pellets_and_no_number_that_helps(heart: OperatingHeart) -> None:
    class Tool:
        sent = SentForce(0.0, np.zeros(3), SupervisorState.OK, Hazard.NONE)

    class Player:
        tip_mm = np.array([1.0, 2.0, 3.0])

    feed = practice.TrainingFeed(heart, practice.Practice("cutting", sight="side-by-side"))
    scene = json.loads(b"".join(feed.scene()))
    assert scene["training"]["sight"] == "side-by-side"
    assert scene["fixtures"] == []
    assert feed.next_event() is None
    loop, task = pellets.pellet_trial(heart, "cutting", closed_loop.Condition(""), 1)
    feed.begin(loop, task, "cutting, with force")
    task.done = 4
    feed.observe(0.25, Player(), Tool())
    event = json.loads(feed.next_event() or "")
    assert len(event["pellets"]) == 6
    np.testing.assert_allclose(event["pellets"][0], task.pellets.target_mm(4, 0.25 / 0.6), atol=1e-3)
    waiting = np.array(event["pellets"][1:])
    depth_mm = heart.truth.distance(waiting, np.full(5, 0.25 / 0.6))[0]
    assert np.abs(depth_mm).max() < 0.5, "those that wait lie on the surface"
    assert "distance_mm" not in event
    assert not any(name.startswith("force") for name in event)
    assert ["pellet", "5 of 10"] in event["rows"]
    assert feed.next_event() is None
