"""Pose streams and tracked sequences: interpolation, statuses, and joining recorded frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.core import InvalidInputError, PoseStream, TrackedSequence


def turning(
    n: int, valid: np.ndarray | None = None, step_s: float = 0.1, source: str = "probe"
) -> PoseStream:
    """A steady screw motion: 0.2 rad and (1, 0, -2) mm a sample."""
    turns = Rotation.from_rotvec(np.outer(np.arange(n) * 0.2, [0, 0, 1])).as_matrix()
    shifts = np.outer(np.arange(n), [1.0, 0.0, -2.0])
    ok = np.ones(n, dtype=bool) if valid is None else valid
    return PoseStream("tracker", source, np.arange(n) * step_s, turns, shifts, ok)


@given(st.floats(0.0, 0.9))
def test_interpolation_follows_a_steady_motion(t_s: float) -> None:
    pose = turning(10).at(t_s)
    assert pose is not None
    expected = Rotation.from_rotvec([0, 0, 2.0 * t_s]).as_matrix()
    np.testing.assert_allclose(pose.rotation, expected, atol=1e-9)
    np.testing.assert_allclose(pose.translation_mm, np.array([10.0, 0.0, -20.0]) * t_s, atol=1e-9)


def test_invalid_samples_are_never_interpolated_over() -> None:
    valid = np.ones(10, dtype=bool)
    valid[4] = False
    stream = turning(10, valid)
    assert stream.at(0.35) is None
    assert stream.at(0.40) is None
    assert stream.at(0.45) is None
    assert stream.at(0.30) is not None
    assert stream.at(0.95) is None  # beyond the end
    with pytest.raises(InvalidInputError, match="did not report OK"):
        stream.pose(4)


def test_long_gaps_are_not_bridged() -> None:
    assert turning(5, step_s=0.3).at(0.45) is None


def test_scaled_tracker_pose_is_refused_unless_its_status_says_so() -> None:
    stream = turning(4)
    scaled = stream.rotations.copy()
    scaled[2] *= 1.01
    with pytest.raises(InvalidInputError, match="sample 2: not a rotation"):
        PoseStream("tracker", "probe", stream.t_s, scaled, stream.translations_mm, stream.valid)
    flagged = np.array([True, True, False, True])
    PoseStream("tracker", "probe", stream.t_s, scaled, stream.translations_mm, flagged)


def test_sequence_joins_transforms_through_a_shared_frame() -> None:
    probe, reference = turning(6), turning(6, source="reference")
    sequence = TrackedSequence(
        probe.t_s,
        None,
        np.zeros(6, dtype=bool),
        {"tracker_from_probe": probe, "tracker_from_reference": reference},
    )
    joined = sequence.stream("reference", "probe")
    np.testing.assert_allclose(joined.rotations, np.tile(np.eye(3), (6, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(joined.translations_mm, 0, atol=1e-12)
    with pytest.raises(
        InvalidInputError, match="no transform phantom_from_probe; it records tracker_from_probe"
    ):
        sequence.stream("phantom", "probe")


def test_times_must_increase() -> None:
    stream = turning(3)
    with pytest.raises(InvalidInputError, match="do not increase"):
        PoseStream(
            "tracker",
            "probe",
            np.array([0, 0.1, 0.1]),
            stream.rotations,
            stream.translations_mm,
            stream.valid,
        )
