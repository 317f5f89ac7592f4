"""Single-wall calibration: a plane cut by a few lines of geometry here, and data_synth's recordings."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.phantoms.wall import WallSpec, wall_recording
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import accepted, calibrate_wall, find_wall_lines, validate_wall
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, PoseStream, QualityGateError, Rigid

SCALE = np.array([0.21, 0.17])
TRUE_MAP = ImageMap(Rigid.from_rotation_vector([0.4, -2.0, 1.1], [11.0, 48.0, -2.0], "probe", "image"), SCALE)
NORMAL = np.array([2.0, -1.0, 2.0]) / 3.0
OFFSET_MM = -640.0


def lines(
    frames: int, tilt_rad: float, noise_px: float, seed: int, slides: tuple[float, float] = (1.0, 1.0)
) -> tuple[PoseStream, FloatArray]:
    """Image planes that look at the wall n·x = d; two columns of each image meet it at these rows."""
    rng = np.random.default_rng(seed)
    # image rows run against the normal before tilts
    across = np.cross(NORMAL, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    upright = np.column_stack([across, -NORMAL, np.cross(across, -NORMAL)])
    spin = Rotation.from_rotvec(np.outer(rng.uniform(0, 2 * np.pi, frames), NORMAL))
    tilt = Rotation.from_rotvec(rng.uniform(-tilt_rad, tilt_rad, (frames, 3)) * [1.0, 0.0, 1.0])
    turn = (spin * Rotation.from_matrix(upright) * tilt).as_matrix()
    along = np.stack([across, np.cross(NORMAL, across)])
    origin = NORMAL * (OFFSET_MM + rng.uniform(40, 110, (frames, 1)))
    origin += rng.uniform(-40, 40, (frames, 2)) * slides @ along
    columns = np.array([-60.0, 60.0])
    u, v = turn[:, :, 0] @ NORMAL, turn[:, :, 1] @ NORMAL
    depth_mm = (OFFSET_MM - origin @ NORMAL)[:, None] - u[:, None] * columns * SCALE[0]
    rows = depth_mm / (v[:, None] * SCALE[1])
    points = np.stack([np.broadcast_to(columns, rows.shape), rows], axis=2)
    rotations = turn @ TRUE_MAP.rigid.rotation.T
    shifts = origin - np.einsum("fij,j->fi", rotations, TRUE_MAP.rigid.translation_mm)
    poses = PoseStream(
        "tracker", "probe", 0.1 * np.arange(frames), rotations, shifts, np.ones(frames, dtype=bool)
    )
    return poses, points + noise_px * rng.standard_normal(points.shape)


def worst_corner_mm(found: ImageMap) -> float:
    corners = np.array([[-60.0, 200], [60, 200], [-60, 600], [60, 600]])
    gap = found.apply_pixels(corners).xyz_mm - TRUE_MAP.apply_pixels(corners).xyz_mm
    return float(np.linalg.norm(gap, axis=1).max())


@pytest.mark.parametrize("seed", range(3))
def test_an_exact_wall_gives_the_exact_map_from_no_guess(seed: int) -> None:
    found = calibrate_wall(*lines(40, 0.6, 0.0, seed), rng=np.random.default_rng(seed))
    assert worst_corner_mm(found.probe_from_image) < 1e-5
    side = np.sign(found.target.normal @ NORMAL)
    np.testing.assert_allclose(side * found.target.normal, NORMAL, atol=1e-7)
    assert side * found.target.offset_mm == pytest.approx(OFFSET_MM, abs=1e-4)
    assert found.inliers.all()


def test_noise_is_averaged_out_and_wrong_lines_are_left_out() -> None:
    poses, points = lines(100, 0.6, 1.0, 11)
    points = points.copy()
    points[40:60, 0, 1] += 100.0
    points[70] = np.nan
    found = calibrate_wall(poses, points, rng=np.random.default_rng(0))
    assert not found.inliers[40:60].any()
    assert found.inliers.sum() >= 75
    assert dict(found.rejected)[70].detail == "the target was not found in the image"
    gap = np.abs(found.uncertainty.covers(TRUE_MAP))
    assert (gap < 2.0).all()
    # a wall leaves the axial position least determined
    assert found.uncertainty.center_mm.argmax() == 1
    assert worst_corner_mm(found.probe_from_image) < 1.5


def test_a_wall_seen_face_on_is_refused_by_name() -> None:
    with pytest.raises(QualityGateError, match="axial position") as caught:
        accepted(calibrate_wall(*lines(60, 0.15, 1.0, 3), rng=np.random.default_rng(0)))
    assert "tilt the probe further" in str(caught.value)


def test_a_probe_that_slides_along_one_line_only_is_refused() -> None:
    # the image's origin stays in a plane across the wall: an image of no size fits as well
    with pytest.raises(QualityGateError, match="along the wall"):
        accepted(calibrate_wall(*lines(60, 0.6, 1.0, 3, (1.0, 0.0)), rng=np.random.default_rng(0)))


def test_misuse() -> None:
    poses, points = lines(40, 0.6, 0.0, 6)
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInputError, match="given by 2"):
        calibrate_wall(poses, points[:, :1], rng=rng)
    with pytest.raises(InvalidInputError, match="needed at least 15"):
        calibrate_wall(poses, np.full_like(points, np.nan), rng=rng)
    with pytest.raises(QualityGateError):
        accepted(calibrate_wall(poses, points[::-1], rng=rng))
    other = ImageMap(Rigid.identity("stylus", "image"), SCALE)
    with pytest.raises(InvalidInputError, match="sensor 'stylus'"):
        validate_wall(other, poses, points)


def test_a_second_recording_finds_its_own_wall() -> None:
    errors, plane = validate_wall(TRUE_MAP, *lines(50, 0.5, 0.0, 9))
    assert errors.frames_used == 50
    assert errors.summary.mean < 1e-9
    assert abs(plane.normal @ NORMAL) == pytest.approx(1.0)
    assert abs(plane.offset_mm) == pytest.approx(-OFFSET_MM)


def test_lines_found_in_synthetic_images_calibrate_within_their_intervals() -> None:
    probe = SectorProbe()
    mount = Rigid.from_rotation_vector([1.5, 0.3, -0.4], [10.0, 40.0, -5.0], "probe", "plane")
    truth = ImageMap(mount @ probe.plane_from_image.rigid, probe.plane_from_image.scale_mm_per_px)
    made = wall_recording(
        truth, probe, TrackerSpec(rate_hz=12.0), WallSpec(frames=40), np.random.default_rng(3)
    )
    sequence = made.recording.sequence
    assert sequence.images is not None
    seen = find_wall_lines(sequence.images, rng=np.random.default_rng(0)).end_points_px(sequence.image_valid)
    found = calibrate_wall(sequence.stream("tracker", "probe"), seen, rng=np.random.default_rng(0))
    assert found.inliers.sum() > 34
    assert (np.abs(found.uncertainty.covers(truth)) < 2.0).all()
