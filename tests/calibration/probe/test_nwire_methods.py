"""Methods side by side: chosen on calibration frames alone; intervals that hold the ground truth."""

import numpy as np
import pytest

from data_synth.phantoms.nwire import NWireSpec, nwire_recording
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import (
    NWIRE_METHODS,
    Gate,
    NWireOptions,
    calibrate_nwire,
    compare_nwire_methods,
    validate_nwire,
)
from dvf_ig.calibration.probe.map_parameters import MapParameters
from dvf_ig.calibration.probe.nwire import usable_wires
from dvf_ig.calibration.probe.nwire_residuals import AllWires, MiddleWires
from dvf_ig.calibration.probe.nwire_solve import NWireMethod
from dvf_ig.core import ImageMap, InvalidInputError, NWireRecording, Rigid

PROBE = SectorProbe()
MOUNT = Rigid.from_rotation_vector([1.5, 0.3, -0.4], [10.0, 40.0, -5.0], "probe", "plane")


def recording(scale: tuple[float, float], noise_mm: float, seed: int) -> NWireRecording:
    return nwire_recording(
        truth(scale),
        PROBE.fan,
        (PROBE.columns, PROBE.rows),
        TrackerSpec(rate_hz=12.0, dropouts_per_min=1.0),
        NWireSpec(point_noise_mm=noise_mm),
        np.random.default_rng(seed),
    )


def truth(scale: tuple[float, float]) -> ImageMap:
    return ImageMap(MOUNT @ PROBE.plane_from_image.rigid, np.array(scale))


def test_oblong_pixels_are_not_called_square() -> None:
    found = compare_nwire_methods(recording((0.52, 0.48), 0.2, 1), rng=np.random.default_rng(0))
    errors = found.cross_validated_mm
    assert set(errors) == set(NWIRE_METHODS)
    assert errors["isotropic"] > 1.3 * min(errors.values())
    assert found.chosen == min(errors, key=lambda m: errors[m]) != "isotropic"
    assert found.best.method == found.chosen
    frames = [r.inliers for r in found.results.values()]
    assert all(np.array_equal(frames[0], other) for other in frames)


@pytest.mark.parametrize("method", ["orthogonal", "isotropic", "all-wires"])
def test_intervals_hold_the_true_map(method: NWireMethod) -> None:
    options = NWireOptions(method=method)
    found = calibrate_nwire(recording((0.5, 0.5), 0.2, 2), rng=np.random.default_rng(0), options=options)
    assert (np.abs(found.uncertainty.covers(truth((0.5, 0.5)))) < 2.0).all()
    # 0.2 mm dots over 115 frames of nine wires
    assert found.uncertainty.center_mm.max() < 0.15
    assert 0.1 < np.sqrt((found.uncertainty.held_out_mm**2).mean()) < 1.0


def test_every_frame_left_out_has_its_reason() -> None:
    made = recording((0.5, 0.5), 0.2, 3)
    points = made.points_px.copy()
    points[5, 4] = np.nan
    points[6] = np.nan
    points[7, 1::3] += 25.0
    altered = NWireRecording(made.phantom, made.phantom_from_probe, points)
    found = calibrate_nwire(altered, rng=np.random.default_rng(0))
    reasons = dict(found.rejected)
    assert set(reasons) == set(np.flatnonzero(~found.inliers).tolist())
    assert made.phantom.wires[4].name in reasons[5].detail
    assert reasons[6].detail == "no wire was found"
    assert "a middle wire misses by" in reasons[7].detail


def test_a_refused_method_is_not_chosen() -> None:
    made = recording((0.5, 0.5), 0.2, 4)
    points = np.where(np.arange(120)[:, None, None] < 5, made.points_px, np.nan)
    with pytest.raises(InvalidInputError, match="frames are usable"):
        compare_nwire_methods(
            NWireRecording(made.phantom, made.phantom_from_probe, points), rng=np.random.default_rng(0)
        )
    oblong = recording((0.6, 0.4), 0.2, 4)
    found = compare_nwire_methods(oblong, rng=np.random.default_rng(0))
    assert [why.gate for why in found.results["isotropic"].refusals] == [Gate.RESIDUAL]
    assert not found.best.refusals


def test_real_sweeps_agree_within_their_intervals(real_sweeps: tuple[NWireRecording, NWireRecording]) -> None:
    first, second = real_sweeps
    found = compare_nwire_methods(first, rng=np.random.default_rng(0))
    held_out = validate_nwire(found.best.probe_from_image, second)
    assert found.chosen == "orthogonal"
    assert held_out.summary.mean95 <= 0.55
    assert held_out.frames_used == held_out.frames == 103
    # two sweeps of one probe: differences of the eight numbers over their joint 95 % half-widths
    center = np.array([400.0, 300.0])
    again = calibrate_nwire(second, rng=np.random.default_rng(0)).uncertainty.about(center)
    spread = found.best.uncertainty.about(center)
    gap = spread.parameters.step_to(again.parameters.estimate)
    assert (np.abs(gap / np.hypot(spread.half_width, again.half_width)) < 1.5).all()


@pytest.mark.parametrize("isotropic", [False, True])
def test_jacobians_are_the_derivatives_of_the_residuals(isotropic: bool) -> None:
    made = recording((0.5, 0.5), 0.2, 5)
    points = usable_wires(made, 1)
    # off the estimate, so that residuals are not small
    off = MapParameters(truth((0.51, 0.49)), np.array([170.0, 160.0])).stepped(
        np.array([0.02, -0.03, 0.01, 1.0, -0.5, 0.7, 0.0, 0.0])
    )
    parameters = MapParameters(off, np.array([170.0, 160.0]), isotropic)
    for wires in (MiddleWires.of(made.phantom), AllWires(made.phantom, np.array([0.4, 0.2]))):
        slope, residuals = wires.jacobian(parameters, points), wires.residuals(off, points)
        steps = 1e-6 * np.eye(parameters.count)
        ends = [[wires.residuals(parameters.stepped(sign * s), points) for sign in (1, -1)] for s in steps]
        # costs, not residuals: those of the middle wires are along axes that turn with the map
        numeric = np.array([((a**2).sum(axis=1) - (b**2).sum(axis=1)) / 4e-6 for a, b in ends]).T
        np.testing.assert_allclose(np.einsum("fkp,fk->fp", slope, residuals), numeric, rtol=1e-5, atol=1e-4)
