"""The rows of `dvf-ig bench --servo`, and that its C++ floor does the work that it stands for."""

import gc

import numpy as np
import pytest

from dvf_ig.core import DvfModel, Rigid
from dvf_ig.guidance import Evaluator, Sigmoid
from dvf_ig.study.bench.servo import bench_servo, compiled_floor
from dvf_ig.study.bench.timing import bench_model, random_points


@pytest.fixture(scope="module")
def model() -> DvfModel:
    return bench_model(step_mm=10.0, phases=4)


def test_every_loop_has_its_row(model: DvfModel) -> None:
    gc.freeze()  # the load collects garbage, not among all that earlier tests have left
    done = bench_servo(model, 0.2, seed=1)
    rows = {row.what: row for row in done.rows}
    assert set(rows) == {
        "servo floor",
        "servo 1 kHz",
        "servo 4 kHz",
        "servo floor, 4 kHz",
        "servo python thread",
    }
    for what, row in rows.items():
        assert 0.0 < row.median_us <= row.p99_us <= row.p999_us <= row.max_us
        assert 0 < done.ticks[what] <= done.due[what]
    assert set(done.forced_ticks) == {"servo 1 kHz", "servo 4 kHz"}
    assert done.ticks["servo python thread"] < done.ticks["servo 1 kHz"]


def test_the_c_plus_plus_floor_gives_the_same_force(model: DvfModel) -> None:
    pose = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], model.frame, "tracker")
    law = Sigmoid()
    floor = compiled_floor(model, pose, law)
    if floor is None:
        pytest.skip("no C++ compiler, so there is no floor to compare with")
    rng = np.random.default_rng(3)
    tip = np.ascontiguousarray(pose.inverse().apply_array(random_points(model.reference[0], 500, rng)))
    phase, out = rng.uniform(size=500), np.empty((500, 4))
    floor.forces(tip, phase, out)(0, 500)
    exact = Evaluator(model, law).force_through(pose, tip, phase)
    ok = np.linalg.norm(exact.gradient, axis=1) > 0.6
    np.testing.assert_allclose(out[ok, :3], exact.force_n[ok], atol=1e-4)
    np.testing.assert_allclose(out[ok, 3], exact.distance_mm[ok], atol=1e-3)
