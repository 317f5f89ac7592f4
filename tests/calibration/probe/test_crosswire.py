"""Cross-wire calibration: a point imaged by a few lines of geometry here, and data_synth's recordings."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.phantoms.crosswire import CrossWireSpec, crosswire_recording
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import Rejection, TargetOptions, accepted, calibrate_crosswire, validate_crosswire
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, PoseStream, QualityGateError, Rigid

SCALE = np.array([0.21, 0.17])
TRUE_MAP = ImageMap(Rigid.from_rotation_vector([0.4, -2.0, 1.1], [11.0, 48.0, -2.0], "probe", "image"), SCALE)
CROSSING = np.array([-120.0, 60.0, -700.0])


def sightings(
    frames: int, noise_mm: float, seed: int, rotation_vectors: FloatArray | None = None
) -> tuple[PoseStream, FloatArray]:
    """Poses that put the pixel where the crossing is seen upon the crossing, off by noise in 3-D."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 50], [600, 700], (frames, 2))
    if rotation_vectors is None:
        rotation_vectors = rng.uniform(-0.7, 0.7, (frames, 3))
    rotations = (Rotation.from_rotvec([1.0, 2.0, -0.5]) * Rotation.from_rotvec(rotation_vectors)).as_matrix()
    seen = np.column_stack([pixels * SCALE, np.zeros(frames)]) @ TRUE_MAP.rigid.rotation.T
    seen += TRUE_MAP.rigid.translation_mm
    shifts = CROSSING - np.einsum("fij,fj->fi", rotations, seen) + noise_mm * rng.standard_normal((frames, 3))
    poses = PoseStream(
        "tracker", "probe", 0.1 * np.arange(frames), rotations, shifts, np.ones(frames, dtype=bool)
    )
    return poses, pixels[:, None]


def worst_corner_mm(found: ImageMap) -> float:
    corners = np.array([[0.0, 50], [600, 50], [0, 700], [600, 700]])
    gap = found.apply_pixels(corners).xyz_mm - TRUE_MAP.apply_pixels(corners).xyz_mm
    return float(np.linalg.norm(gap, axis=1).max())


@pytest.mark.parametrize("seed", range(5))
def test_an_exact_crossing_gives_the_exact_map_from_no_guess(seed: int) -> None:
    found = calibrate_crosswire(*sightings(20, 0.0, seed), rng=np.random.default_rng(seed))
    assert worst_corner_mm(found.probe_from_image) < 1e-7
    np.testing.assert_allclose(found.target.xyz_mm, CROSSING, atol=1e-7)
    assert found.inliers.all()
    assert found.rejected == ()


def test_noise_is_averaged_out_and_frames_are_left_out_with_a_reason() -> None:
    poses, points = sightings(120, 0.4, 7)
    points = points.copy()
    points[20:50] += 40.0
    points[60] = np.nan
    valid = poses.valid.copy()
    valid[61] = False
    poses = PoseStream("tracker", "probe", poses.t_s, poses.rotations, poses.translations_mm, valid)
    found = calibrate_crosswire(poses, points, rng=np.random.default_rng(0))
    # 0.4 mm over 88 frames, levers of up to 1.5: 0.1 mm
    assert worst_corner_mm(found.probe_from_image) < 0.3
    assert not found.inliers[20:50].any()
    reasons = dict(found.rejected)
    assert set(reasons) == {*range(20, 50), 60, 61}
    kinds = [reasons[i].reason for i in (20, 60, 61)]
    assert kinds == [Rejection.OUTLIER, Rejection.NOT_FOUND, Rejection.POSE_INVALID]
    assert "misses the target by" in reasons[20].detail
    assert "not found" in reasons[60].detail
    assert "tracker_from_probe is not valid" in reasons[61].detail
    # held-out residuals: sqrt(3) per-axis noise, a little more than the fitted ones
    assert found.held_out.summary.mean == pytest.approx(0.4 * np.sqrt(8 / np.pi), rel=0.15)


def test_square_pixels_where_asked_for() -> None:
    found = calibrate_crosswire(
        *sightings(60, 0.05, 2),
        rng=np.random.default_rng(0),
        options=TargetOptions(isotropic=True, max_rms_mm=50.0),
    )
    scale = found.probe_from_image.scale_mm_per_px
    assert scale[0] == scale[1]
    assert found.uncertainty.covariance.shape == (7, 7)


@pytest.mark.parametrize(
    ("rotation_vectors", "undetermined", "advice"),
    [
        (np.zeros((40, 3)), "lateral position", "about all three axes"),
        (np.outer(np.linspace(-0.7, 0.7, 40), [0.0, 0.0, 1.0]), "position", "about all three axes"),
    ],
)
def test_too_little_motion_is_refused_by_name(
    rotation_vectors: FloatArray, undetermined: str, advice: str
) -> None:
    with pytest.raises(QualityGateError, match=undetermined) as caught:
        accepted(calibrate_crosswire(*sightings(40, 0.1, 3, rotation_vectors), rng=np.random.default_rng(0)))
    assert advice in str(caught.value)


def test_a_crossing_that_never_moves_in_the_image_is_refused() -> None:
    poses, points = sightings(40, 0.0, 4)
    with pytest.raises(QualityGateError, match="stays at one pixel"):
        accepted(
            calibrate_crosswire(
                poses, np.broadcast_to(points[:1], points.shape), rng=np.random.default_rng(0)
            )
        )


def test_points_at_one_depth_do_not_determine_the_pixel_height() -> None:
    rng = np.random.default_rng(5)
    poses, points = sightings(40, 0.0, 5)
    level = np.stack([points[:, :, 0], np.full((40, 1), 300.0)], axis=2)
    seen = np.column_stack([level[:, 0] * SCALE, np.zeros(40)]) @ TRUE_MAP.rigid.rotation.T
    seen += TRUE_MAP.rigid.translation_mm
    shifts = CROSSING - np.einsum("fij,fj->fi", poses.rotations, seen)
    moved = PoseStream("tracker", "probe", poses.t_s, poses.rotations, shifts, poses.valid)
    with pytest.raises(QualityGateError, match=r"pixel height.*near and far"):
        accepted(calibrate_crosswire(moved, level, rng=rng))


def test_misuse() -> None:
    poses, points = sightings(40, 0.0, 6)
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInputError, match="shape"):
        calibrate_crosswire(poses, points[:-1], rng=rng)
    with pytest.raises(InvalidInputError, match="shows 1"):
        calibrate_crosswire(poses, np.concatenate([points, points], axis=1), rng=rng)
    with pytest.raises(InvalidInputError, match="needed at least 15"):
        calibrate_crosswire(poses, np.where(np.arange(40)[:, None, None] < 5, points, np.nan), rng=rng)
    with pytest.raises(QualityGateError, match=r"agree|miss"):
        accepted(calibrate_crosswire(poses, points[::-1], rng=rng))
    other = ImageMap(Rigid.identity("stylus", "image"), SCALE)
    with pytest.raises(InvalidInputError, match="sensor 'stylus'"):
        validate_crosswire(other, poses, points)


def test_a_second_recording_finds_its_own_crossing() -> None:
    found = calibrate_crosswire(*sightings(80, 0.1, 8), rng=np.random.default_rng(0))
    errors, crossing = validate_crosswire(found.probe_from_image, *sightings(50, 0.3, 9))
    assert errors.frames_used == 50
    np.testing.assert_allclose(crossing, CROSSING, atol=0.3)
    assert errors.summary.mean == pytest.approx(0.3 * np.sqrt(8 / np.pi), rel=0.2)


def test_synthetic_recording_lies_within_its_own_intervals() -> None:
    probe = SectorProbe()
    mount = Rigid.from_rotation_vector([1.5, 0.3, -0.4], [10.0, 40.0, -5.0], "probe", "plane")
    truth = ImageMap(mount @ probe.plane_from_image.rigid, probe.plane_from_image.scale_mm_per_px)
    made = crosswire_recording(
        truth, probe, TrackerSpec(rate_hz=12.0), CrossWireSpec(), np.random.default_rng(3), rendered=False
    )
    poses = made.recording.sequence.stream("tracker", "probe")
    found = calibrate_crosswire(poses, made.recording.features_px, rng=np.random.default_rng(0))
    assert (np.abs(found.uncertainty.covers(truth)) < 2.0).all()
    assert np.linalg.norm(found.target.xyz_mm - made.crossing.xyz_mm[0]) < 0.5
