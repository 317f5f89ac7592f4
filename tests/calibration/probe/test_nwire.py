"""N-wire calibration: a phantom imaged by a few lines of geometry here, and PLUS's real recording."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.calibration import NWIRE_METHODS, NWireOptions, accepted, calibrate_nwire, validate_nwire
from dvf_ig.calibration.probe.errors import CalibrationErrors, calibration_errors, known_points_refusals
from dvf_ig.calibration.probe.nwire_residuals import diagonal_crossings
from dvf_ig.calibration.probe.nwire_solve import NWireMethod
from dvf_ig.core import (
    FloatArray,
    ImageMap,
    InvalidInputError,
    NWirePhantom,
    NWireRecording,
    PoseStream,
    QualityGateError,
    Rigid,
    Wire,
)

SCALE = np.array([0.081, 0.074])
TRUE_MAP = ImageMap(Rigid.from_rotation_vector([0.4, -0.9, 1.1], [11.0, 48.0, -2.0], "probe", "image"), SCALE)
CENTER_PX = np.array([400.0, 300.0])


def phantom() -> NWirePhantom:
    """Three N patterns 10 mm apart; diagonals end 5 mm short of the outer wires, as in PLUS's phantom."""
    rows = []
    for z, (a, b) in ((20.0, (55, 35)), (10.0, (35, 55)), (0.0, (55, 40))):
        ends = ((30, 30), (a, b), (60, 60))
        rows.append(
            tuple(
                Wire(f"w{z:g}-{k}", np.array([f, 0, z]), np.array([g, 40, z]))
                for k, (f, g) in enumerate(ends)
            )
        )
    return NWirePhantom(tuple(rows))


def image_wires(frames: int, noise_px: float, seed: int) -> NWireRecording:
    """Cut the wires with image planes held roughly across them; nothing here is shared with the method."""
    rng = np.random.default_rng(seed)
    wires = phantom().wires
    rotations, shifts, dots = [], [], np.empty((frames, len(wires), 2))
    for i in range(frames):
        # image columns along phantom x, rows along z, seen from a few degrees off
        across = Rotation.from_matrix(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]))
        phantom_from_image = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3)) * across
        middle = np.array([45, 20, 10]) + rng.uniform(-6, 6, 3)
        origin = middle - phantom_from_image.apply(np.append(CENTER_PX * SCALE, 0))
        for k, wire in enumerate(wires):
            u, v, w = (phantom_from_image.as_matrix()[:, j] for j in range(3))
            along = wire.back_mm - wire.front_mm
            met = wire.front_mm + along * (w @ (origin - wire.front_mm)) / (w @ along)
            dots[i, k] = np.array([u @ (met - origin), v @ (met - origin)]) / SCALE
        rotation = phantom_from_image.as_matrix() @ TRUE_MAP.rigid.rotation.T
        rotations.append(rotation)
        shifts.append(origin - rotation @ TRUE_MAP.rigid.translation_mm)
    dots += noise_px * rng.standard_normal(dots.shape)
    poses = PoseStream(
        "phantom",
        "probe",
        np.arange(frames) * 0.1,
        np.array(rotations),
        np.array(shifts),
        np.ones(frames, bool),
    )
    return NWireRecording(phantom(), poses, dots)


def corner_error_mm(found: ImageMap) -> float:
    corners = np.array([[0.0, 0], [800, 0], [0, 600], [800, 600]])
    gap = found.apply_pixels(corners).xyz_mm - TRUE_MAP.apply_pixels(corners).xyz_mm
    return float(np.linalg.norm(gap, axis=1).max())


def altered(recording: NWireRecording, points: FloatArray) -> NWireRecording:
    return NWireRecording(recording.phantom, recording.phantom_from_probe, points)


@pytest.mark.parametrize("method", [m for m in NWIRE_METHODS if m != "isotropic"])
def test_exact_wires_give_the_exact_map(method: NWireMethod) -> None:
    recording = image_wires(40, 0.0, 1)
    options = NWireOptions(method=method)
    found = calibrate_nwire(recording, rng=np.random.default_rng(0), options=options)
    assert corner_error_mm(found.probe_from_image) < 1e-6
    assert found.calibration.summary.mean < 1e-6
    assert max(found.calibration.in_plane_mm.values()) < 1e-6
    assert np.allclose(found.matrix, TRUE_MAP.matrix, atol=1e-7)


def test_isotropic_pixels_are_used_when_asked_for() -> None:
    recording = image_wires(40, 0.0, 1)
    found = calibrate_nwire(recording, rng=np.random.default_rng(0), options=NWireOptions(method="isotropic"))
    scale = found.probe_from_image.scale_mm_per_px
    assert scale[0] == scale[1]


@pytest.mark.parametrize("method", ["linear", "orthogonal", "all-wires"])
def test_noise_is_averaged_out(method: NWireMethod) -> None:
    recording = image_wires(150, 2.0, 2)
    options = NWireOptions(method=method)
    found = calibrate_nwire(recording, rng=np.random.default_rng(0), options=options)
    # a dot's 2 px (0.16 mm) become 0.3 mm along the wire; 450 dots and a lever of three leave 0.1 mm
    assert corner_error_mm(found.probe_from_image) < 0.25
    held_out = validate_nwire(found.probe_from_image, image_wires(50, 2.0, 3))
    assert held_out.frames_used == 50
    assert held_out.summary.mean95 < held_out.summary.mean < 0.6


def test_wrong_frames_are_left_out() -> None:
    recording = image_wires(100, 1.0, 4)
    points = recording.points_px.copy()
    points[10:30, 1::3] += 60.0
    points[50] = np.nan
    found = calibrate_nwire(altered(recording, points), rng=np.random.default_rng(0))
    assert not found.inliers[10:30].any()
    assert not found.inliers[50]
    assert found.inliers.sum() >= 75
    assert found.calibration.frames_used == 99
    assert corner_error_mm(found.probe_from_image) < 0.2


def test_diagonal_is_extended_to_the_outer_wires() -> None:
    start, stop = diagonal_crossings(phantom().patterns[0])
    assert np.allclose(start, [30, 50, 20])
    assert np.allclose(stop, [60, -10, 20])


def test_refusals() -> None:
    recording = image_wires(40, 0.5, 5)
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInputError, match=r"0 of 40 frames are usable .*all 9 wires"):
        calibrate_nwire(altered(recording, np.full_like(recording.points_px, np.nan)), rng=rng)
    few = recording.points_px.copy()
    few[5:] = np.nan
    with pytest.raises(InvalidInputError, match=r"5 of 40 frames are usable .*all 9 wires"):
        calibrate_nwire(altered(recording, few), rng=rng)
    with pytest.raises(InvalidInputError, match="choose linear"):
        calibrate_nwire(recording, rng=rng, options=NWireOptions(method="magic"))
    swapped = recording.points_px[:, [2, 1, 0, 5, 4, 3, 8, 7, 6]]
    with pytest.raises(QualityGateError):
        accepted(calibrate_nwire(altered(recording, swapped), rng=rng))
    other = ImageMap(Rigid.identity("stylus", "image"), SCALE)
    with pytest.raises(InvalidInputError, match="belongs to sensor 'stylus'"):
        validate_nwire(other, recording)


def test_wires_that_form_no_n_are_refused() -> None:
    good = phantom().patterns[0]
    with pytest.raises(InvalidInputError, match="not parallel"):
        diagonal_crossings((good[0], good[2], good[1]))
    lift = np.array([0.0, 0.0, 5.0])
    lifted = Wire("lifted", good[1].front_mm + lift, good[1].back_mm + lift)
    with pytest.raises(InvalidInputError, match="lie in one plane"):
        diagonal_crossings((good[0], lifted, good[2]))


def errors_of(mean_mm: float) -> CalibrationErrors:
    return calibration_errors(np.full(40, mean_mm), 40)


@pytest.mark.parametrize(
    ("own_mm", "turned_deg", "cause"),
    [
        (1.1, 5.8, "1.10 mm as well, so the marker has not moved; its sweep turns the probe by 5.8° only"),
        (1.1, 40.0, "so the marker has not moved; check the phantom's wiring"),
        (0.4, 5.8, "0.40 mm off in the calibration's own frames, so the marker may have moved"),
    ],
)
def test_known_points_name_the_likely_cause(own_mm: float, turned_deg: float, cause: str) -> None:
    """A poor sweep misses its own frames as much as those of the validation; a moved marker does not."""
    (refusal,) = known_points_refusals(errors_of(1.24), own=errors_of(own_mm), turned_deg=turned_deg)
    assert "1.24 mm" in refusal.detail
    assert "the gate of 1 mm (--max-residual-mm moves it)" in refusal.detail
    assert cause in refusal.detail
    assert not known_points_refusals(errors_of(1.24), own=errors_of(own_mm), limit_mm=1.3)


def test_real_recording_against_its_validation_set(
    real_sweeps: tuple[NWireRecording, NWireRecording],
) -> None:
    first, second = real_sweeps
    found = calibrate_nwire(first, rng=np.random.default_rng(0))
    held_out = validate_nwire(found.probe_from_image, second)
    assert held_out.frames_used == held_out.frames == 103
    assert held_out.summary.mean95 <= 0.55
    published = np.array([[-0.000519165, 0.0744587], [-0.0803067, -6.68987e-05], [0.00181709, -0.000804192]])
    # PLUS's own tolerance against its baseline: 1 mm
    corner = np.array([820.0, 616.0])
    theirs = published @ corner + [11.2137, 48.4162, -0.398993]
    assert np.linalg.norm(found.probe_from_image.apply_pixels(corner[None]).xyz_mm[0] - theirs) < 1.0
