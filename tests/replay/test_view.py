"""A replay as a page: what the folder keeps for it, what is asked for when something is missing, and what a
browser shows (skipped where Chromium is absent)."""

import csv
import json
import shutil
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from browser import MISSING, Page, browser, chromium
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, Landmarks, Points, UnreadableFileError
from dvf_ig.guidance import FixtureOptions, FixtureSet, Sigmoid
from dvf_ig.intake import cached_model
from dvf_ig.replay import Replay
from dvf_ig.replay.page.replay_page import _overlays
from dvf_ig.replay.result.labels import change_of_shape, last_shown
from dvf_ig.replay.result.result import validate
from dvf_ig.replay.run_folder import read_run, read_ticks
from dvf_ig.replay.view import _fixtures
from dvf_ig.replay.view_file import read_view_file, write_view_file
from dvf_ig.report.viewer import RegistrationView, live_page, registration_payload, viewer_html
from dvf_ig.report.viewer.scene import tool_payload

NEEDS_BROWSER = pytest.mark.skipif(chromium() is None, reason=MISSING)


@pytest.fixture(scope="module")
def page_file(run: Path, written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a folder that was moved away from its recording."""
    moved = tmp_path_factory.mktemp("elsewhere") / "run"
    shutil.copytree(run, moved)
    out = moved.parent / "page.html"
    done = CliRunner().invoke(
        app, ["view", str(moved), "--recording", str(written), "-o", str(out), "--json"]
    )
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["megabytes"] == pytest.approx(out.stat().st_size / 1e6, abs=1e-3)
    assert told["frames"] > 100
    return out


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser") / "profile") as page:
        page.resize(1200, 800)
        yield page


@pytest.fixture(scope="module")
def opened(window: Page, page_file: Path) -> Page:
    window.requests()
    began = perf_counter()
    window.open(page_file.as_uri())
    ready_ms = window.until("return window.dvf && (window.dvf.ready_ms || window.dvf.error)")
    told = f"viewer ready after {ready_ms:.0f} ms ({perf_counter() - began:.2f} s with the driver)"
    sys.stdout.write(f"\n{told}\n")
    return window


def test_the_models_of_further_structures_are_kept_in_the_folder(
    replay: Replay, written: Path, tmp_path: Path
) -> None:
    atrium = replace(replay.heart.model, surface_name="atrium")
    parts = tuple(FixtureOptions(Sigmoid(cap_n=0.1), structure=one) for one in (atrium, None, atrium))
    setup = replace(replay.setup, fixtures=FixtureSet(parts))
    write_view_file(replace(replay, setup=setup), tmp_path, tmp_path, written, None)
    first, heart, last = read_view_file(tmp_path).structures
    assert first is last
    assert first is not None
    assert heart is None
    assert first.surface_name == "atrium"
    np.testing.assert_array_equal(first.coefficients, atrium.coefficients)


def test_the_folder_reads_back(replay: Replay, written: Path, run: Path) -> None:
    folder, ticks = read_run(run), replay.ticks
    assert folder.view.recording.resolve() == written.resolve()
    np.testing.assert_allclose(folder.ticks["force_tracker_y_n"], ticks.force_n[:, 1], atol=5.1e-7)
    for name in ("status", "supervisor", "hazards"):
        np.testing.assert_array_equal(folder.ticks[name], getattr(ticks, name))
    np.testing.assert_array_equal(np.isnan(folder.ticks["pose_bound_mm"]), np.isnan(ticks.pose_bound_mm))
    np.testing.assert_allclose(folder.view.r_peaks_s, [p.t_s for p in replay.history.peaks], atol=1e-6)
    poses = folder.view.pose_at(ticks.t_s)
    used = np.isfinite(ticks.mr_from_tracker[:, 0, 0])
    assert 0.2 < used.mean() < 0.9
    np.testing.assert_array_equal(np.isfinite(poses[:, 0, 0]), used)
    tip = ticks.tip_tracker_mm[used]
    off = np.einsum("nij,nj->ni", (poses - ticks.mr_from_tracker)[used, :, :3], tip)
    off += (poses - ticks.mr_from_tracker)[used, :, 3]
    assert np.abs(off[np.isfinite(off[:, 0])]).max() < 0.02
    assert (run / "view.json").stat().st_size < 100_000


def test_device_and_tool_of_a_run_come_back(run: Path) -> None:
    """Without its device, a run with more than 4 N could not be shown."""
    folder = read_run(run)
    assert folder.result["device"] is None
    device = {"name": "omega.3", "continuous_force_n": 12.0, "stiffness_n_per_m": 3000.0}
    fulcrum = {"point_mm": [10.0, 20.0, 30.0], "length_mm": 350.0}
    tool = {"diameter_mm": 5.0, "shaft_mm": 60.0, "axis": None, "fulcrum": fulcrum}
    stated = {"device": device, "fixtures_cap_n": 9.0, "tool": tool}
    strong = replace(folder, result=folder.result | stated)
    validate(strong.result)
    found = _fixtures(strong)
    assert (found.joint_cap_n, found.device.name, found.device.stiffness_n_per_m) == (9.0, "omega.3", 3000.0)
    assert (found.tool.diameter_mm, found.tool.shaft_mm) == (5.0, 60.0)
    assert tool_payload(found.tool) == {"diameter_mm": 5.0, "shaft_mm": 60.0}
    assert tool_payload(_fixtures(folder).tool) is None


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("view.json", "replay again with this version"),
        ("result.json", "holds no result.json"),
        ("ticks.csv", "cannot read"),
    ],
)
def test_what_the_folder_lacks_is_named(run: Path, tmp_path: Path, name: str, told: str) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / name).unlink()
    with pytest.raises(UnreadableFileError, match=told):
        read_run(folder)


def test_a_damaged_table_is_refused(run: Path, tmp_path: Path) -> None:
    lines = (run / "ticks.csv").read_text().splitlines()[:4]
    for spoilt in (
        [lines[0] + ",more", *lines[1:]],
        [*lines, "1,2"],
        [*lines[:3], lines[3].replace("fade", "fad")],
    ):
        (tmp_path / "ticks.csv").write_text("\n".join(spoilt))
        with pytest.raises(UnreadableFileError, match="replay again"):
            read_ticks(tmp_path / "ticks.csv")


def test_a_recording_that_moved_is_asked_for(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere" / "run"
    shutil.copytree(run, folder)
    done = CliRunner().invoke(app, ["view", str(folder)])
    assert done.exit_code == 2
    assert "--recording" in done.stderr


def test_another_recording_is_refused(run: Path, written: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(written, other)
    with (other / "ecg.csv").open("a") as table:
        table.write("\n")
    done = CliRunner().invoke(app, ["view", str(run), "--recording", str(other)])
    assert done.exit_code == 3
    assert "ecg.csv differs" in done.stderr


@NEEDS_BROWSER
def test_the_page_opens_without_a_request_or_a_complaint(opened: Page) -> None:
    asked = [url for url in opened.requests() if not url.startswith(("file:", "data:", "blob:", "chrome:"))]
    assert asked == []
    assert [text for text in opened.complaints() if "ReadPixels" not in text] == []


@NEEDS_BROWSER
def test_values_at_the_cursor_are_those_of_the_table(opened: Page, run: Path) -> None:
    with (run / "ticks.csv").open() as table:
        rows = list(csv.DictReader(table))
    contact = max(range(len(rows)), key=lambda i: abs(float(rows[i]["force_tracker_x_n"])))
    for i in (0, 3000, contact, len(rows) - 1):
        row = rows[i]
        shown = opened.run("return dvf.seek(arguments[0])", float(row["t_s"]))
        for name in (
            "t_s",
            "phi",
            "model_phase",
            "distance_mm",
            "force_tracker_x_n",
            "tip_mr_z_mm",
            "pose_bound_mm",
        ):
            assert shown[name] == (float(row[name]) if row[name] else None), name
        force = np.linalg.norm([float(row[f"force_tracker_{axis}_n"]) for axis in "xyz"])
        assert shown["force_n"] == pytest.approx(force, abs=1e-12)
        assert (shown["status"], shown["supervisor"]) == (row["status"], row["supervisor"])
        assert "|".join(shown["hazards"]) == row["hazards"]
        text = opened.run("return document.getElementById('numbers').innerText.replace(/\\s+/g, ' ')")
        assert f"force {force:.2f} N" in text
    result = json.loads((run / "result.json").read_text())
    largest = opened.run(
        "const s = dvf.viewer.series; return s.t.reduce((most, _, i) => Math.max(most, s.force(i)), 0)"
    )
    assert largest == pytest.approx(result["force_n"]["max"], abs=2e-6)


@NEEDS_BROWSER
def test_the_contour_lies_on_the_models_surface(opened: Page, run: Path, model: DvfModel) -> None:
    """Its points, through the frame's own matrix, are where the model's distance is zero."""
    from dvf_ig.guidance import Evaluator, Sigmoid

    shown = opened.run("return dvf.seek(arguments[0])", 14.5)
    organ = next(one for one in shown["contours"] if one["role"] == "organ")
    pixels = np.array(organ["segments"]).reshape(-1, 2)
    assert len(pixels) > 50
    matrix = opened.run(
        "return Array.from(dvf.viewer.series.frames.mr_from_pixel[arguments[0]])", shown["frame"]
    )
    phase = opened.run("return dvf.viewer.series.frames.model_phase[arguments[0]]", shown["frame"])
    xyz = np.column_stack([pixels, np.ones(len(pixels))]) @ np.reshape(matrix, (3, 3)).T
    evaluator = Evaluator(model, Sigmoid())
    distance = evaluator.force(xyz, phase).distance_mm
    assert np.percentile(np.abs(distance), 95) < 0.5
    near = xyz[::9] + 1.0
    field = opened.run(FIELD, near.tolist(), phase)
    known = [i for i, one in enumerate(field) if one]
    true = evaluator.force(near[known], phase).force_n
    assert np.median(np.linalg.norm(np.array([field[i] for i in known]) - true, axis=1)) < 0.03


@NEEDS_BROWSER
def test_labels_in_the_image_are_those_of_the_model(opened: Page, model: DvfModel, replay: Replay) -> None:
    """Looked up by the page as by the model; their contours and properties appear with a key."""
    shown_last = last_shown(replay)
    assert shown_last is not None
    warp = change_of_shape(shown_last)
    assert warp is not None
    tissue, rng = model.tissue, np.random.default_rng(2)
    assert tissue is not None
    grid = tissue.labels.grid
    places = grid.to_mm(rng.uniform(0.0, np.array(grid.shape) - 1.0, (3000, 3)))
    for phase in (0.0, 0.33):
        true = tissue.label_at(warp.model_places(places), phase, model.timing)
        shown = np.array(opened.run(LABELS, places.tolist(), phase))
        assert (shown == true).mean() > 0.98
        assert len(np.unique(shown)) > 1
    shown = opened.run("return dvf.seek(arguments[0])", 14.5)
    assert not [one for one in shown["contours"] if one["role"] == "label"]
    key = "document.body.dispatchEvent(new KeyboardEvent('keydown', {key: 'l', bubbles: true}))"
    listed = f"{key}; dvf.state(); return document.getElementById('tissue').innerText"
    text = opened.run(listed)
    contours = opened.run("return dvf.state().contours")
    names = [one["name"] for one in contours if one["role"] == "label" and one["segments"]]
    assert names
    assert all(name.lower().replace("_", " ") in text for name in names)
    assert opened.run(f"{key}; dvf.state(); return document.getElementById('tissue').hidden")


LABELS = (
    "const labels = dvf.viewer.heart.labels; labels.phase(arguments[1]);"
    "return arguments[0].map((p) => labels.at(p))"
)
FIELD = "return arguments[0].map((p) => dvf.forceAt(arguments[1], ...p))"


@pytest.fixture(scope="module")
def model(replay: Replay) -> DvfModel:
    return cached_model(replay.scenario.preop).model


@NEEDS_BROWSER
def test_keys_step_from_beat_to_beat_and_play(opened: Page, run: Path) -> None:
    peaks = read_run(run).view.r_peaks_s
    opened.run("dvf.seek(arguments[0])", float(peaks[6]) + 0.2)
    press = (
        "document.body.dispatchEvent(new KeyboardEvent('keydown', {key: arguments[0], bubbles: true}));"
        "return dvf.state().cursor_s"
    )
    for key, peak in (("ArrowUp", peaks[6]), ("ArrowUp", peaks[5]), ("ArrowDown", peaks[6])):
        shown = opened.run(press, key)
        assert shown == pytest.approx(peak, abs=1e-9)
    opened.run("dvf.play()")
    opened.until(f"return dvf.state().cursor_s > {peaks[6] + 0.05}")
    opened.run("dvf.pause()")


@NEEDS_BROWSER
def test_a_registration_is_shown_plane_by_plane(
    replay: Replay, opened: Page, model: DvfModel, tmp_path: Path
) -> None:
    planes = _overlays(replay)
    corner = np.array([0.0, 0.0, 1.0])
    target = Points("mr", (np.asarray(planes[1].anatomy_from_pixel) @ corner)[None])
    view = RegistrationView(
        "toy", "nobody", True, "It <converged>.", [("error bound", "3.0 mm")], planes, "MR", model,
        Landmarks(("corner",), target), 3.0,
    )  # fmt: skip
    page = tmp_path / "view.html"
    page.write_text(viewer_html(registration_payload(view)), encoding="utf-8")
    opened.open(page.as_uri())
    opened.until("return window.dvf && (window.dvf.ready || window.dvf.error)")
    for i, plane in enumerate(planes):
        shown = opened.run("return dvf.seek(arguments[0])", i + 0.3)
        assert shown["frame"] == i
        assert plane.name in opened.run("return document.getElementById('frame').textContent")
        assert any(one["role"] == "organ" and len(one["segments"]) > 100 for one in shown["contours"])
    placed = opened.run("return Array.from(dvf.viewer.series.frames.mr_from_pixel[1])")
    step = np.array(planes[1].size_mm) / [*opened.run(SIZE)]
    assert np.linalg.norm(np.reshape(placed, (3, 3))[:, 0]) == pytest.approx(step[0], rel=0.02)
    text = opened.run("return document.getElementById('numbers').innerText")
    assert "It <converged>." in text
    assert "< 3.0 mm at 95 %" in text
    assert [url for url in opened.requests() if url.startswith("http")] == []


SIZE = "return [dvf.viewer.scene.image.columns, dvf.viewer.scene.image.rows]"


@NEEDS_BROWSER
def test_a_session_is_shown_as_it_runs(window: Page, opened: Page, page_file: Path) -> None:
    """The page asks its server for the scene and listens to its events."""
    text = page_file.read_text().split('id="dvf-scene">')[1].split("</script>")[0]
    whole = json.loads(text)
    frames = whole.pop("series")["frames"]
    event = {
        **dict.fromkeys(("rr_s", "tip_mr_x_mm", "distance_mm", "pose_age_s", "pose_bound_mm")),
        "phi": 0.25,
        "phase_valid": 1,
        "model_phase": 0.3,
        "margin_mm": 0.0,
        **{f"force_tracker_{axis}_n": 0.3 for axis in "xyz"},
        "status": "no_pose",
        "supervisor": "fade",
        "hazards": "no_pose|pose_unconfirmed",
    }
    picture = {
        "event_s": 1.01,
        "model_phase": 0.3,
        "mr_from_pixel": None,
        "image": frames["images"][0],
        "mime": frames["mime"],
    }
    events = [
        event | {"t_s": 1.0, "ecg": {"t_s": [0.9, 1.0], "values": [0.1, 0.2]}},
        event | {"t_s": 1.03, "frame": picture},
    ]
    with _Served(json.dumps(whole | {"kind": "live"}), events) as address:
        window.open(address)
        window.until("return window.dvf && window.dvf.ready")
        shown = window.until("const s = dvf.state(); return s.t_s > 1.02 && s.frame === 0 && s")
    assert (shown["phi"], shown["supervisor"], shown["hazards"]) == (
        0.25,
        "fade",
        ["no_pose", "pose_unconfirmed"],
    )
    assert shown["force_n"] == pytest.approx(0.3 * np.sqrt(3))
    assert shown["distance_mm"] is None


class _Served:
    """A server of one page, its scene and its events, on loopback."""

    def __init__(self, scene: str, events: list[dict[str, object]]) -> None:
        answers = {"/": ("text/html", live_page()), "/scene.json": ("application/json", scene)}
        stream = "".join(f"data: {json.dumps(event)}\n\n" for event in events)
        answers["/events"] = ("text/event-stream", stream)

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                kind, body = answers[self.path]
                self.send_response(200)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.end_headers()
                self.wfile.write(body.encode())

            def log_message(self, *_: object) -> None:
                """Nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)

    def __enter__(self) -> str:
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05})
        self._thread.start()
        return f"http://127.0.0.1:{self._server.server_address[1]}/"

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
