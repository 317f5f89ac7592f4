"""The mesh search that the fixture is compared with, the points, and the shape of `dvf-ig bench`."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from toy_sphere import sphere
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, InvalidInputError, Mesh
from dvf_ig.io import write_model
from dvf_ig.preop import build_triangle_tree
from dvf_ig.study.bench.calls import BenchOptions
from dvf_ig.study.bench.peers import CovarianceTree, signs
from dvf_ig.study.bench.timing import (
    REACH_MM,
    bench_model,
    hand_path,
    random_points,
    time_batches,
    time_calls,
)


@pytest.fixture(scope="module")
def model() -> DvfModel:
    return bench_model(step_mm=10.0, phases=2)


def test_covariance_tree_finds_the_exact_distance(model: DvfModel) -> None:
    mesh = model.reference[0]
    points = random_points(mesh, 150, np.random.default_rng(1))
    search = CovarianceTree(mesh)
    exact = build_triangle_tree(mesh.vertices_mm, mesh.triangles).distance_mm(points)
    np.testing.assert_allclose(search.distances_mm(points), exact, atol=1e-9)
    singly = [search.distance_mm(point) for point in points[::-1]]
    np.testing.assert_allclose(singly, exact[::-1], atol=1e-9)


def test_the_hand_stays_in_reach_and_moves_like_a_hand(model: DvfModel) -> None:
    mesh = model.reference[0]
    path = hand_path(mesh, 1999, np.random.default_rng(2))
    distance = build_triangle_tree(mesh.vertices_mm, mesh.triangles).distance_mm(path)
    assert distance.max() <= REACH_MM + 1e-9
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert 0.01 < np.median(step) < 0.5
    assert step.max() < 1.0


def test_timing_counts_every_call() -> None:
    seen: list[tuple[int, int]] = []
    spent = time_batches(lambda i, j: seen.append((i, j)), 10, 3, 1)
    assert seen == [(0, 3), (0, 3), (3, 6), (6, 9)]
    assert len(spent) == 3
    assert len(time_calls(len, [((),)] * 7, 2)) == 7


def test_too_few_calls_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="needed at least 100"):
        BenchOptions(calls=10)


def test_bench_prints_rows_and_ratios(
    model: DvfModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # two more processes would say nothing about the shape of the result
    monkeypatch.setattr("dvf_ig.study.bench.calls.first_call_seconds", lambda: 0.25)
    write_model(model, tmp_path / "model.npz")
    arguments = [str(tmp_path / "model.npz"), "--calls", "100", "--repeats", "1", "--continuity", "300"]
    result = CliRunner().invoke(app, ["bench", *arguments, "-o", str(tmp_path / "out"), "--json"])
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert payload == json.loads((tmp_path / "out" / "bench.json").read_text())
    rows = {(r["name"], r["what"]): r for r in payload["rows"]}
    for what in (
        "static kernel",
        "static python",
        "dynamic kernel",
        "dynamic python",
        "dynamic safe",
        "guided python",
        "batch",
    ):
        assert rows["dvf_ig", what]["error_mm"] < 1.0
    assert rows["open3d", "static python"]["error_mm"] < 1e-3
    assert {("scipy cKDTree", "static tree"), ("covariance tree (numba)", "static tree")} <= set(rows)
    for r in rows.values():
        assert 0.0 <= r["median_us"] <= r["p99_us"] <= r["p999_us"] <= r["max_us"]
    assert payload["ratios"]["open3d / static python"] == pytest.approx(
        rows["open3d", "static python"]["median_us"] / rows["dvf_ig", "static python"]["median_us"]
    )
    assert payload["first_call_s"] == 0.25
    assert [c["violations"] for c in payload["continuity"]] == [0] * 6


def test_bench_without_open3d_leaves_its_rows_out_and_says_so(
    model: DvfModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvf_ig.study.bench.calls.first_call_seconds", lambda: 0.25)
    monkeypatch.setitem(sys.modules, "open3d", None)
    write_model(model, tmp_path / "model.npz")
    arguments = [str(tmp_path / "model.npz"), "--calls", "100", "--repeats", "1", "--json"]
    result = CliRunner().invoke(app, ["bench", *arguments])
    assert result.exit_code == 0, result.output
    assert "open3d cannot be loaded, and its rows are left out" in result.stderr
    rows = {(r["name"], r["what"]): r for r in json.loads(result.stdout)["rows"]}
    assert not any(name == "open3d" for name, _ in rows)
    assert rows["dvf_ig", "static kernel"]["error_mm"] < 1.0
    assert ("scipy cKDTree", "static tree") in rows


def test_signs_of_a_ball() -> None:
    vertices, triangles = sphere(30.0, 3)
    points = np.random.default_rng(2).uniform(-40.0, 40.0, (500, 3))
    length = np.linalg.norm(points, axis=1)
    clear = np.abs(length - 30.0) > 1.0
    found = signs(Mesh("mr", vertices, triangles), points)
    np.testing.assert_array_equal(found[clear], np.where(length < 30.0, 1.0, -1.0)[clear])
