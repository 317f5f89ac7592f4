"""Time stamps: jitter cut at least three times, causally; drop-outs and jumps; poses between stamps."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.calibration import StampFilter, StampOptions, filter_stamps, filtered_stream
from dvf_ig.core import FloatArray, InvalidInputError, PoseStream
from dvf_ig.io import read_sequence
from dvf_ig.io.plus.raw_sequence import read_raw_sequence


def stamps(
    seed: int, *, rate_hz: float = 20.0, jitter_s: float = 0.005, dropped: float = 0.0, count: int = 500
) -> tuple[FloatArray, FloatArray]:
    """True times of the frames that arrived, and their stamps."""
    rng = np.random.default_rng(seed)
    true_s = (np.arange(count) / rate_hz)[rng.uniform(size=count) >= dropped]
    return true_s, np.maximum.accumulate(true_s + jitter_s * rng.standard_normal(len(true_s)))


def strictly(t_s: FloatArray) -> FloatArray:
    return np.asarray(t_s + 1e-9 * np.arange(len(t_s)))


@pytest.mark.parametrize(
    ("rate_hz", "jitter_s", "dropped"), [(20.0, 0.005, 0.0), (20.0, 0.005, 0.05), (50.0, 0.002, 0.02)]
)
def test_jitter_falls_by_three(rate_hz: float, jitter_s: float, dropped: float) -> None:
    before, after = [], []
    for seed in range(3):
        true_s, stamp_s = stamps(seed, rate_hz=rate_hz, jitter_s=jitter_s, dropped=dropped)
        found = filter_stamps(strictly(stamp_s))
        before.append((stamp_s - true_s)[80:])
        after.append((found.t_s - true_s)[80:])
        assert np.abs(found.shift_s).max() < 0.08
        assert (np.diff(found.t_s) > 0).all()
        assert found.restarts == 0
    # a line over 60 stamps has an end of SD 2/√60: 3.9 times less
    assert np.concatenate(before).std() / np.concatenate(after).std() > 3.0
    assert abs(np.concatenate(after).mean()) < 0.0005


def test_the_filter_never_looks_ahead() -> None:
    _, stamp_s = stamps(3, dropped=0.05)
    whole = filter_stamps(strictly(stamp_s)).t_s
    part = filter_stamps(strictly(stamp_s)[:237]).t_s
    assert np.array_equal(whole[:237], part)
    live = StampFilter()
    assert [live.push(float(t)) for t in strictly(stamp_s)[:50]] == part[:50].tolist()


def test_a_drop_out_does_not_bend_the_line() -> None:
    true_s = np.delete(np.arange(300) / 20.0, [100, 101, 102, 200])
    found = filter_stamps(true_s)
    assert np.abs(found.shift_s).max() < 1e-9


def test_a_jump_of_the_clock_and_a_long_pause_start_anew() -> None:
    t_s = np.arange(200) / 20.0
    paused = np.where(t_s < 5.0, t_s, t_s + 30.013)
    found = filter_stamps(paused)
    assert found.restarts == 1
    assert np.abs(found.shift_s).max() < 1e-9
    slower = np.concatenate([t_s, t_s[-1] + np.arange(1, 200) / 11.0])
    assert np.abs(filter_stamps(slower).shift_s).max() < 0.08


def test_refused_stamps() -> None:
    with pytest.raises(InvalidInputError, match="needed finite, increasing stamps"):
        filter_stamps(np.array([0.0, 1.0, 1.0]))
    with pytest.raises(InvalidInputError, match="needed finite, increasing stamps"):
        filter_stamps(np.array([0.0, np.nan]))
    with pytest.raises(InvalidInputError, match="warm-up of 90"):
        StampOptions(warm_up=90)


def test_a_filtered_stream_keeps_poses_and_status() -> None:
    _, stamp_s = stamps(1, count=100)
    valid = np.ones(100, bool)
    valid[40:45] = False
    turns, shifts = np.tile(np.eye(3), (100, 1, 1)), np.arange(300.0).reshape(100, 3)
    found = filtered_stream(PoseStream("tracker", "probe", strictly(stamp_s), turns, shifts, valid))
    assert np.array_equal(found.valid, valid)
    assert np.array_equal(found.translations_mm, shifts)


def test_real_stamps_are_not_dragged_by_late_frames(data_dir: Path) -> None:
    """A recorder's own filter moved these by 70 ms, and for twenty frames after each late one."""
    raw = read_raw_sequence(
        data_dir / "plus-temporal-watertank" / "WaterTankBottomTranslationVideoBuffer.igs.mha"
    )
    plain, recorders = raw.numbers("UnfilteredTimestamp"), raw.numbers("Timestamp")
    assert plain is not None
    assert recorders is not None
    found = filter_stamps(plain)
    assert np.abs(recorders - plain).max() > 0.06
    assert np.abs(found.shift_s).max() < 0.03
    assert found.shift_s.std() < 0.5 * (recorders - plain).std()


@pytest.mark.parametrize("part", ["Calibration", "Validation"])
def test_held_out_poses_of_a_freehand_sweep(data_dir: Path, part: str) -> None:
    path = data_dir / "plus-fcal20-nwire" / f"fCal_Test_{part}_3NWires_fCal2.0.igs.mha"
    probe = read_sequence(path).stream("tracker", "probe")
    kept = slice(None, None, 2)
    half = PoseStream(
        "tracker",
        "probe",
        probe.t_s[kept],
        probe.rotations[kept],
        probe.translations_mm[kept],
        probe.valid[kept],
    )
    rotations, translations, ok = half.at_many(probe.t_s[1::2])
    assert ok[:-1].mean() > 0.9
    misses = np.linalg.norm(translations - probe.translations_mm[1::2], axis=1)[ok]
    turns = np.swapaxes(rotations, 1, 2) @ probe.rotations[1::2]
    angles = np.degrees(Rotation.from_matrix(turns[ok]).magnitude())
    # most of it is the noise of the magnetic sensor: two poses at rest differ by as much
    assert misses.mean() <= 0.5
    assert angles.mean() <= 0.2
    assert angles.max() <= 1.0


def test_lost_poses_are_not_interpolated_over() -> None:
    t_s = np.arange(10) * 0.05
    valid = np.ones(10, bool)
    valid[4] = False
    turns = np.tile(np.eye(3), (10, 1, 1))
    stream = PoseStream("tracker", "probe", t_s, turns, np.column_stack([t_s, t_s, t_s]), valid)
    assert stream.at(0.175) is None
    assert stream.at(0.21) is None
    assert stream.at(0.2) is None
    between = stream.at(0.125)
    assert between is not None
    assert np.allclose(between.translation_mm, 0.125)
