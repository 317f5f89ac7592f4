"""Sensors that fail: a frozen pose keeps bits and status, a restarted clock the order of arrival."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.signals.tracker import TrackerSpec, tracked
from data_synth.signals.tracker_failure import (
    ClockRestartSpec,
    TrackerFailureSpec,
    split_at_restart,
    with_frozen_poses,
)
from dvf_ig.core import BoolArray, InvalidInputError, PoseStream

SECONDS = 4.0


def moving(valid: BoolArray | None = None) -> PoseStream:
    """40 poses at 10 Hz, of which no two are equal."""
    t_s = np.arange(40) / 10.0
    rotations = Rotation.from_euler("z", t_s[:, None]).as_matrix()
    shifts = np.column_stack([t_s, 2 * t_s, 0 * t_s])
    return PoseStream(
        "tracker", "tool", t_s, rotations, shifts, np.ones(40, bool) if valid is None else valid
    )


def test_a_frozen_pose_repeats_the_last_ok_one_bit_for_bit() -> None:
    valid = np.ones(40, bool)
    valid[[19, 25, 35]] = False  # the last before the failure, one during it, one after it
    stream = moving(valid)
    frozen = with_frozen_poses(stream, TrackerFailureSpec(at_share=0.5, frozen_s=1.0), SECONDS)
    np.testing.assert_array_equal(frozen.t_s, stream.t_s)
    assert frozen.valid[20:30].all(), "it is reported as fresh"
    assert (frozen.rotations[20:30] == stream.rotations[18]).all()
    assert (frozen.translations_mm[20:30] == stream.translations_mm[18]).all()
    for part in (slice(0, 20), slice(30, 40)):
        np.testing.assert_array_equal(frozen.rotations[part], stream.rotations[part])
        np.testing.assert_array_equal(frozen.translations_mm[part], stream.translations_mm[part])
        np.testing.assert_array_equal(frozen.valid[part], stream.valid[part])


def test_without_a_failure_or_anything_to_repeat_the_stream_stays() -> None:
    stream = moving()
    assert with_frozen_poses(stream, TrackerFailureSpec(), SECONDS) is stream
    assert with_frozen_poses(stream, TrackerFailureSpec(at_share=0.0, frozen_s=1.0), SECONDS) is stream
    assert split_at_restart(stream, ClockRestartSpec(), SECONDS) == (stream, None)


def test_a_lost_sensor_is_not_ok_to_the_end() -> None:
    def still(t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.tile(np.eye(3), (len(t_s), 1, 1)), np.ones((len(t_s), 3))

    t_s = np.arange(40) / 10.0
    spec = TrackerSpec(rate_hz=10.0, lost_s=TrackerFailureSpec(at_share=0.25, lost=True).lost_s(SECONDS))
    stream = tracked(still, "tracker", "probe", t_s, t_s, spec, np.random.default_rng(0))
    np.testing.assert_array_equal(stream.valid, t_s < 1.0)
    assert TrackerFailureSpec(frozen_s=3.0).lost_s(SECONDS) == ()


def test_a_restarted_clock_stamps_what_follows_earlier() -> None:
    stream = moving()
    before, after = split_at_restart(stream, ClockRestartSpec(back_s=1.5), SECONDS)
    assert after is not None
    assert (len(before), len(after)) == (20, 20)
    np.testing.assert_array_equal(before.t_s, stream.t_s[:20])
    np.testing.assert_allclose(after.t_s, stream.t_s[20:] - 1.5, atol=1e-9)
    np.testing.assert_array_equal(after.translations_mm, stream.translations_mm[20:])
    np.testing.assert_array_equal(after.rotations, stream.rotations[20:])


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (TrackerFailureSpec, {"at_share": 1.5}),
        (TrackerFailureSpec, {"frozen_s": -1.0}),
        (ClockRestartSpec, {"at_share": 0.0}),
        (ClockRestartSpec, {"back_s": -1.0}),
    ],
)
def test_impossible_failures_are_refused(kind: type, changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match="needed"):
        kind(**changes)
