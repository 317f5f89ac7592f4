"""SE(3) between named frames: group axioms, frame checks, refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import FrameMismatchError, ImageMap, InvalidInputError, Points, Rigid

component = st.floats(-3.0, 3.0)
vectors = st.tuples(component, component, component)


def rigid(turn: tuple[float, ...], shift: tuple[float, ...], target: str, source: str) -> Rigid:
    return Rigid.from_rotation_vector(turn, 50 * np.array(shift), target, source)


@given(vectors, vectors, vectors, vectors)
def test_composition_inverse_and_application_agree(
    a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...], d: tuple[float, ...]
) -> None:
    mr_from_tracker, tracker_from_probe = rigid(a, b, "mr", "tracker"), rigid(c, d, "tracker", "probe")
    mr_from_probe = mr_from_tracker @ tracker_from_probe
    points = Points("probe", np.array([[1.0, 2.0, 3.0], [-40.0, 0.0, 90.0]]))
    stepwise = mr_from_tracker.apply(tracker_from_probe.apply(points))
    np.testing.assert_allclose(mr_from_probe.apply(points).xyz_mm, stepwise.xyz_mm, atol=1e-9)
    back = mr_from_probe.inverse().apply(stepwise)
    assert back.frame == "probe"
    np.testing.assert_allclose(back.xyz_mm, points.xyz_mm, atol=1e-9)


@given(vectors, vectors, vectors, vectors, st.floats(0, 1))
def test_interpolation_is_exact_at_both_ends_and_symmetric(
    a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...], d: tuple[float, ...], w: float
) -> None:
    first = rigid(a, b, "mr", "tracker")
    turn = np.array(c) / 3  # below π, so the shortest way is unique
    second = first @ Rigid.from_rotation_vector(turn, d, "tracker", "tracker")
    np.testing.assert_allclose(first.interpolated(second, 0.0).matrix, first.matrix, atol=1e-9)
    np.testing.assert_allclose(first.interpolated(second, 1.0).matrix, second.matrix, atol=1e-9)
    there, back = first.interpolated(second, w), second.interpolated(first, 1 - w)
    np.testing.assert_allclose(there.matrix, back.matrix, atol=1e-8)


def test_left_perturbation_turns_about_the_given_centre() -> None:
    pose = Rigid.from_rotation_vector([0.3, 0.2, -0.5], [10.0, 20.0, 30.0], "mr", "tracker")
    center = np.array([5.0, -7.0, 60.0])
    turned = pose.perturbed_left([0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0], center)
    at_center = pose.inverse().apply_array(center)
    np.testing.assert_allclose(turned.apply_array(at_center), center, atol=1e-9)
    beside = pose.inverse().apply_array(center + np.eye(3)[0])
    np.testing.assert_allclose(turned.apply_array(beside), center + np.eye(3)[1], atol=1e-9)


def test_frames_that_do_not_meet_are_refused_by_name() -> None:
    mr_from_tracker = Rigid.identity("mr", "tracker")
    with pytest.raises(FrameMismatchError, match="'tracker' does not meet 'image'"):
        mr_from_tracker @ Rigid.identity("image", "probe")
    with pytest.raises(FrameMismatchError, match="needed frame 'tracker', got frame 'probe'"):
        mr_from_tracker.apply(Points("probe", np.zeros((1, 3))))


def test_scale_and_shear_are_refused_but_rounded_digits_are_repaired() -> None:
    matrix = Rigid.from_rotation_vector([0.1, 0.2, 0.3], [1, 2, 3], "mr", "tracker").matrix
    rounded = Rigid.from_matrix(np.round(matrix, 5), "mr", "tracker")
    np.testing.assert_allclose(rounded.matrix, matrix, atol=1e-5)
    scaled = matrix.copy()
    scaled[:3, :3] *= 1.01
    with pytest.raises(InvalidInputError, match="is not rigid"):
        Rigid.from_matrix(scaled, "mr", "tracker")
    mirrored = matrix @ np.diag([-1, 1, 1, 1])
    with pytest.raises(InvalidInputError, match="is not rigid"):
        Rigid.from_matrix(mirrored, "mr", "tracker")
    with pytest.raises(InvalidInputError, match="last row"):
        Rigid.from_matrix(np.ones((4, 4)), "mr", "tracker")


def test_arrays_are_owned_and_read_only() -> None:
    shift = np.zeros(3)
    pose = Rigid("mr", "tracker", np.eye(3), shift)
    shift[0] = 5.0
    assert pose.translation_mm[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        pose.translation_mm[0] = 1.0


PLUS_IMAGE_TO_PROBE = [
    [-0.000519165, 0.0744587, 0.000837223, 11.2137],
    [-0.0803067, -6.68987e-005, 0.00174527, 48.4162],
    [0.00181709, -0.000804192, 0.0773718, -0.398993],
    [0, 0, 0, 1],
]


def test_published_plus_calibration_is_orthonormalised_and_its_angle_reported() -> None:
    image_map = ImageMap.from_matrix(PLUS_IMAGE_TO_PROBE, "probe")
    np.testing.assert_allclose(image_map.scale_mm_per_px, [0.0803, 0.0745], atol=1e-4)
    assert 0.1 < image_map.shear_deg < 0.5
    corner = image_map.apply_pixels(np.array([[819.0, 615.0]])).xyz_mm[0]
    published = (np.array(PLUS_IMAGE_TO_PROBE) @ [819, 615, 0, 1])[:3]
    assert np.linalg.norm(corner - published) < 0.35  # half of 0.3° over 66 mm


def test_sheared_image_axes_are_refused() -> None:
    sheared = np.array(PLUS_IMAGE_TO_PROBE)
    sheared[:3, 1] += 0.05 * sheared[:3, 0]
    with pytest.raises(InvalidInputError, match="off orthogonal"):
        ImageMap.from_matrix(sheared, "probe")
