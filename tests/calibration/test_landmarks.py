"""Paired points, dwell detection, and the real phantom touched with a stylus."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.calibration import find_dwells, match_dwells, register_landmarks, tip_positions
from dvf_ig.core import InvalidInputError, Points, QualityGateError, Rigid
from dvf_ig.core.paired import fit_paired_points
from dvf_ig.io import read_coordinate_definitions, read_poses
from dvf_ig.io.phantom_landmarks import read_phantom_landmarks

BOX = np.array([[0.0, 0, 0], [90, 0, 0], [90, 60, 0], [0, 60, 20], [40, 30, 50]])
vectors = st.tuples(*[st.floats(-3, 3)] * 3)


@given(vectors, st.tuples(*[st.floats(-500, 500)] * 3), st.integers(3, 5))
def test_exact_pairs_give_the_exact_map(turn: tuple[float, ...], shift: tuple[float, ...], n: int) -> None:
    truth = Rigid.from_rotation_vector(turn, shift, "tracker", "phantom")
    source = Points("phantom", BOX[:n])
    found = fit_paired_points(truth.apply(source), source)
    assert np.allclose(found.matrix, truth.matrix, atol=1e-7)
    back = fit_paired_points(source, truth.apply(source))
    assert np.allclose(back.matrix, truth.inverse().matrix, atol=1e-7)


def test_mirrored_points_still_give_a_rotation() -> None:
    mirrored = BOX * [1, 1, -1]
    found = fit_paired_points(Points("a", mirrored), Points("b", BOX))
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_weights() -> None:
    spoiled = BOX.copy()
    spoiled[4] += 30.0
    weights = np.array([1.0, 1, 1, 1, 0])
    found = fit_paired_points(Points("a", spoiled), Points("b", BOX), weights)
    assert np.allclose(found.matrix, np.eye(4), atol=1e-9)


def test_refused_pairs() -> None:
    with pytest.raises(InvalidInputError, match="2 point pairs"):
        fit_paired_points(Points("a", BOX[:2]), Points("b", BOX[:2]))
    with pytest.raises(InvalidInputError, match="equal counts"):
        fit_paired_points(Points("a", BOX), Points("b", BOX[:4]))
    line = np.outer(np.arange(5.0), [10, 5, 2])
    with pytest.raises(InvalidInputError, match="on one line"):
        fit_paired_points(Points("a", line), Points("b", line))
    with pytest.raises(InvalidInputError, match="none negative"):
        fit_paired_points(Points("a", BOX), Points("b", BOX), np.array([1.0, 1, 1, 1, -1]))


def test_residuals_and_leave_one_out() -> None:
    touched = BOX.copy()
    touched[2, 2] += 4.0
    found = register_landmarks(Points("reference", touched), Points("phantom", BOX))
    assert found.rms_mm == pytest.approx(np.sqrt(np.mean(found.residuals_mm**2)))
    assert int(found.leave_one_out_mm.argmax()) == 2
    assert found.leave_one_out_mm[2] > found.residuals_mm[2], "an error hides in its own fit"


def stylus_path(
    stops: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], Points]:
    """At each stop for 3 s, a straight second between them; 15 Hz, 0.2 mm noise."""
    rng = np.random.default_rng(0)
    pieces = []
    for k, stop in enumerate(stops):
        pieces.append(np.tile(stop, (45, 1)))
        if k + 1 < len(stops):
            pieces.append(stop + np.linspace(0, 1, 15)[:, None] * (stops[k + 1] - stop))
    path = np.concatenate(pieces)
    path = path + 0.2 * rng.standard_normal(path.shape)
    return np.arange(len(path)) / 15.0, Points("reference", path)


def test_dwells_are_found_and_matched_among_others() -> None:
    pose = Rigid.from_rotation_vector([0.3, -1.0, 0.5], [10, 20, 30], "reference", "phantom")
    phantom = Points("phantom", BOX)
    elsewhere = np.array([[300.0, 0, 0]]), np.array([[-200.0, 150, 40]])
    stops = np.concatenate([elsewhere[0], pose.apply(phantom).xyz_mm, elsewhere[1]])
    dwells = find_dwells(*stylus_path(stops))
    assert len(dwells.points) == 7
    # 45 samples of 0.2 mm: the median is good to 0.04 mm a coordinate
    assert np.abs(dwells.points.xyz_mm - stops).max() < 0.2
    found, chosen = match_dwells(dwells, phantom)
    assert chosen == (1, 2, 3, 4, 5)
    assert np.abs(found.target_from_source.apply(phantom).xyz_mm - stops[1:6]).max() < 0.2


def test_refused_dwells() -> None:
    moving = np.outer(np.arange(300.0), [1.0, 0, 0])
    with pytest.raises(QualityGateError, match="never rested"):
        find_dwells(np.arange(300) / 15.0, Points("reference", moving))
    dwells = find_dwells(*stylus_path(BOX[:3]))
    with pytest.raises(InvalidInputError, match="3 places for 5 landmarks"):
        match_dwells(dwells, Points("phantom", BOX))


def test_real_phantom(data_dir: Path) -> None:
    folder = data_dir / "plus-phantom-landmarks"
    device = folder / "PlusDeviceSet_fCal_Sim_RecordPhantomLandmarks.xml"
    poses = read_poses(folder / "EightLandmarkPointsTrackedForPhantomRegistration.igs.mha")
    tip = Points("stylus", read_coordinate_definitions(device)["stylus_from_stylus_tip"][None, :3, 3])
    phantom = read_phantom_landmarks(device)
    found, chosen = match_dwells(find_dwells(*tip_positions(poses, tip)), phantom.points)
    assert len(chosen) == 8
    assert found.rms_mm < 0.5
    published = read_coordinate_definitions(folder / "PhantomRegistrationLandmarkDetection.results.xml")
    theirs = Rigid.from_matrix(published["reference_from_phantom"], "reference", "phantom")
    gap = found.target_from_source.apply(phantom.points).xyz_mm - theirs.apply(phantom.points).xyz_mm
    assert np.linalg.norm(gap, axis=1).max() < 0.5
