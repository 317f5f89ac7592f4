"""A small scenario with something in every field, and a comparison that is exact to the last bit."""

import dataclasses
import enum
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    BreathingTruth,
    CycleTiming,
    Fan,
    Grid,
    ImageMap,
    Landmarks,
    LatencyRecording,
    NWirePhantom,
    NWireRecording,
    Points,
    PoseStream,
    Preop,
    Rigid,
    Scenario,
    ScenarioTruth,
    Signal,
    SurfaceSeries,
    ToolTruth,
    Trace,
    TrackedSequence,
    VolumeSeries,
    Wire,
)
from dvf_ig.io.provenance import recorded_inputs


def make_stream(rng: np.random.Generator, target: str, source: str, t_s: Any) -> PoseStream:
    n = len(t_s)
    rotations = Rotation.random(n, rng=rng).as_matrix()
    valid = rng.random(n) > 0.2
    valid[0] = True
    return PoseStream(target, source, t_s, rotations, rng.normal(size=(n, 3)) * 100, valid)


def make_rigid(rng: np.random.Generator, target: str, source: str) -> Rigid:
    return Rigid(target, source, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 50)


def make_surface(rng: np.random.Generator, name: str, timing: CycleTiming) -> SurfaceSeries:
    vertices = rng.normal(size=(len(timing), 6, 3)) * 40
    triangles = np.array([[0, 1, 2], [3, 4, 5], [0, 2, 4]])
    return SurfaceSeries(name, "mr", vertices, triangles, timing, "heart-7", np.array([False, True, False]))


def make_preop(rng: np.random.Generator) -> Preop:
    timing = CycleTiming(np.array([0.0, 0.31, 0.62]), 0.8123456789, rr_assumed=True)
    turned = Rotation.random(rng=rng).as_matrix()
    grid = Grid("mr", (5, 4, 3), rng.normal(size=3) * 30, rng.uniform(0.5, 3, 3), turned)
    intensities = rng.integers(-900, 900, (3, 5, 4, 3)).astype(np.int16)
    labels = rng.integers(0, 4, (3, 5, 4, 3)).astype(np.uint8)
    return Preop(
        patient_id="heart-7",
        mr=VolumeSeries(grid, intensities, timing),
        labels=VolumeSeries(grid, labels, timing),
        label_names=((1, "LV cavity"), (2, "LV myocardium")),
        organ_labels=(1, 2),
        surfaces=(
            make_surface(rng, "EPICARDIAL", CycleTiming.uniform(4, 0.9)),
            make_surface(rng, "LV_EPICARDIAL", timing),
        ),
    )


def make_nwire(rng: np.random.Generator) -> NWireRecording:
    def wire(name: str) -> Wire:
        return Wire(name, rng.normal(size=3) * 30, rng.normal(size=3) * 30)

    phantom = NWirePhantom(((wire("1:A"), wire("2:B"), wire("3:C")), (wire("4:D"), wire("5:E"), wire("6:F"))))
    points = rng.uniform(0, 300, (5, 6, 2))
    points[2] = np.nan
    points[3, 1] = np.nan
    stream = make_stream(rng, "phantom", "probe", np.arange(5) / 7.0)
    return NWireRecording(phantom, stream, points)


def make_truth(rng: np.random.Generator) -> ScenarioTruth:
    t_s = np.sort(rng.uniform(0, 9, 7))
    return ScenarioTruth(
        mr_from_tracker=((0.0, make_rigid(rng, "mr", "tracker")), (4.5, make_rigid(rng, "mr", "tracker"))),
        probe_from_image=ImageMap(make_rigid(rng, "probe", "image"), rng.uniform(0.1, 0.4, 2)),
        tip=Points("tool", rng.normal(size=(1, 3)) * 90),
        lag_s=-0.0648266,
        r_peaks_s=np.cumsum(rng.uniform(0.6, 1.1, 9)),
        targets=Landmarks(("apex", "base"), Points("mr", rng.normal(size=(2, 3)) * 40)),
        surface=make_surface(rng, "EPICARDIAL", CycleTiming.uniform(5, 0.77)),
        tool=ToolTruth(
            t_s,
            rng.normal(size=(7, 3)),
            rng.random(7),
            rng.random(7),
            rng.normal(size=7),
            rng.normal(size=(7, 3)),
        ),
        mismatch_mm=0.1 + 0.2,
        later_probe_from_image=(
            (3.3, ImageMap(make_rigid(rng, "probe", "image"), rng.uniform(0.1, 0.4, 2))),
            (7.7, ImageMap(make_rigid(rng, "probe", "image"), rng.uniform(0.1, 0.4, 2))),
        ),
        calibrated_probe_from_image=ImageMap(make_rigid(rng, "probe", "image"), rng.uniform(0.1, 0.4, 2)),
        video_drift_ppm=123.4,
        respiration_mm=5.6,
        breathing=BreathingTruth(np.arange(4) / 50.0, rng.normal(size=(4, 3, 4)), rng.normal(size=(4, 2, 3))),
    )


def _make_scenario(seed: int = 0) -> Scenario:
    rng = np.random.default_rng(seed)
    times = 12.0 + np.cumsum(rng.uniform(0.02, 0.1, 8))
    probe = make_stream(rng, "tracker", "probe", times)
    images = rng.integers(0, 256, (8, 16, 12)).astype(np.uint8)
    wall = Trace(np.cumsum(rng.uniform(0.05, 0.1, 20)), rng.uniform(50, 200, 20))
    names = ("apex", "base", "RV point")
    return Scenario(
        name="Everything, everywhere",
        preset="calm",
        preop=make_preop(rng),
        ecg=Signal(rng.normal(size=(400, 2)), 250.0, 11.3, ("II", "V1")),
        ultrasound=TrackedSequence(times, images, rng.random(8) > 0.3, {probe.name: probe}, orientation="MF"),
        fan=Fan(rng.uniform(0, 10, 2), 3.3, 15.7, 0.61),
        tool=make_stream(rng, "tracker", "tool", np.arange(30) / 31.0),
        tip=make_stream(rng, "tracker", "tool", np.arange(12) / 9.0),
        probe=make_nwire(rng),
        latency=LatencyRecording(make_stream(rng, "tracker", "probe", np.arange(25) / 46.0), wall),
        start=make_rigid(rng, "mr", "tracker"),
        landmarks_mr=Landmarks(names, Points("mr", rng.normal(size=(3, 3)) * 50)),
        landmarks_tracker=Landmarks(names, Points("tracker", rng.normal(size=(3, 3)) * 50)),
        seed=seed,
        truth=make_truth(rng),
    )


def _assert_same(a: Any, b: Any, where: str = "value") -> None:
    """Every field of two frozen values equal, arrays bit for bit and of the same type."""
    assert type(a) is type(b), f"{where}: {type(a).__name__} and {type(b).__name__}"
    if dataclasses.is_dataclass(a) and not isinstance(a, type):
        for field in dataclasses.fields(a):
            _assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, f"{where}: {a.dtype} and {b.dtype}"
        np.testing.assert_array_equal(a, b, err_msg=where, strict=True)
    elif isinstance(a, dict):
        _assert_same(list(a), list(b), where)
        for key in a:
            _assert_same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            _assert_same(x, y, f"{where}[{i}]")
    else:
        assert isinstance(a, enum.Enum | str | int | float | bool | None), where
        assert a == b, f"{where}: {a!r} and {b!r}"


@pytest.fixture
def in_a_command() -> Iterator[None]:
    """A command runs: the files of its user are guarded."""
    with recorded_inputs():
        yield


@pytest.fixture(scope="session")
def make_scenario() -> Callable[..., Scenario]:
    """Build the small scenario of a seed."""
    return _make_scenario


@pytest.fixture(scope="session")
def assert_same() -> Callable[..., None]:
    """Compare two values to the last bit."""
    return _assert_same
