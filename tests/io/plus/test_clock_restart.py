"""A recorder whose clock restarts: the recording ends there, in every kind of recording, and says so."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import nwire_of

from dvf_ig.core import FloatArray, PoseStream, Rigid, Scenario
from dvf_ig.io import read_latency_recording, read_nwire_recording, read_sequence, write_poses
from dvf_ig.io.plus.feature_points import read_target_recording
from dvf_ig.io.plus.latency import write_line_table
from dvf_ig.io.plus.nwire import write_nwire_phantom, write_wire_points
from dvf_ig.io.plus.raw_sequence import read_raw_sequence
from dvf_ig.io.plus.sequence_read import clock_restart


def stream(t_s: FloatArray | list[float], valid: list[bool] | None = None) -> PoseStream:
    """tracker_from_probe, sample i lying i mm along x."""
    n = len(t_s)
    shifts = np.column_stack([np.arange(n, dtype=np.float64), np.zeros(n), np.zeros(n)])
    ok = np.ones(n, bool) if valid is None else np.array(valid)
    return PoseStream("tracker", "probe", np.array(t_s), np.tile(np.eye(3), (n, 1, 1)), shifts, ok)


def restarted(path: Path) -> Path:
    """Frames 0 to 5 at 1 to 6 s, then frames 6 to 9 at 0.5 to 3.5 s."""
    write_poses(stream(np.arange(1.0, 7.0)), path, stream(np.arange(0.5, 4.0)))
    return path


@pytest.mark.parametrize(
    ("stamps", "kept", "frame"),
    [
        ([1.0, 2.0, 3.0, 1.5, 2.5], [1.0, 2.0, 3.0], 3),
        # the second trajectory passes the end of the first: its frames are still of another clock
        ([1.0, 2.0, 0.5, 1.5, 2.5], [1.0, 2.0], 2),
        # steps back that are small one by one, and go too far together
        ([1.0, 1.2, 1.12, 1.09, 1.3], [1.0, 1.12, 1.2], 3),
        ([5.0, 1.0, 2.0], [5.0], 1),
    ],
)
def test_a_recording_ends_where_its_clock_restarts(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, stamps: list[float], kept: list[float], frame: int
) -> None:
    path = tmp_path / "a.igs.mha"
    whole = stream(np.arange(len(stamps)))
    write_poses(whole, path)
    text = path.read_text()
    for i, stamp in enumerate(stamps):
        text = text.replace(f"Frame000{i}_Timestamp = {i}.0\n", f"Frame000{i}_Timestamp = {stamp}\n")
    path.write_text(text)
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        sequence = read_sequence(path)
    assert sequence.t_s.tolist() == kept
    assert sequence.poses["tracker_from_probe"].translations_mm[:, 0].max() == frame - 1
    told = [r.getMessage() for r in caplog.records if "jumps back" in r.getMessage()]
    back = max(stamps[:frame]) - stamps[frame]
    assert told == [
        f"{path}: time jumps back by {back:.3f} s at frame {frame} (from {max(stamps[:frame]):.3f} s to "
        f"{stamps[frame]:.3f} s), as when a clock restarts; the {len(stamps) - frame} frames from there on "
        "are not used: split the file there, or record again"
    ]


@given(period_s=st.floats(0.01, 0.1), jitter=st.lists(st.floats(0.0, 0.099), min_size=2, max_size=30))
def test_no_jitter_below_the_limit_ends_a_recording(period_s: float, jitter: list[float]) -> None:
    t_s = period_s * np.arange(len(jitter)) + np.array(jitter)
    assert clock_restart(t_s) is None


def test_poses_after_a_restart_are_written_in_the_order_of_arrival(tmp_path: Path) -> None:
    path = tmp_path / "a.igs.mha"
    write_poses(stream([8.0, 9.0, 9.5]), path, stream([0.5, 1.0], [False, True]))
    raw = read_raw_sequence(path)
    stamps = raw.numbers("Timestamp")
    assert stamps is not None
    assert stamps.tolist() == [8.0, 9.0, 9.5, 0.5, 1.0]
    statuses = raw.frame_fields["ProbeToTrackerTransformStatus"]
    assert [statuses[i] for i in range(5)] == ["OK", "OK", "OK", "INVALID", "OK"]
    assert raw.frame_fields["ProbeToTrackerTransform"][4].split()[3] == "1.0"
    assert read_sequence(path).t_s.tolist() == [8.0, 9.0, 9.5]


def test_a_target_recording_keeps_the_points_before_the_restart(tmp_path: Path) -> None:
    rows = "".join(f"{i},{10 * i},{20 * i}\n" for i in range(10))
    (tmp_path / "p.csv").write_text("frame,column1_px,row1_px\n" + rows)
    poses, points = read_target_recording(restarted(tmp_path / "a.igs.mha"), tmp_path / "p.csv")
    assert len(poses) == len(points) == 6
    assert points[:, 0, 0].tolist() == [0, 10, 20, 30, 40, 50]


def test_a_latency_recording_keeps_the_lines_before_the_restart(tmp_path: Path) -> None:
    write_poses(stream(np.arange(0.0, 8.0)), tmp_path / "t.igs.mha")
    write_line_table(tmp_path / "l.xml", 100.0 + np.arange(10.0))
    video = restarted(tmp_path / "v.igs.mha")
    recording = read_latency_recording(tmp_path / "t.igs.mha", video, tmp_path / "l.xml")
    assert recording.wall_row_px.t_s.tolist() == [1, 2, 3, 4, 5, 6]
    assert recording.wall_row_px.values.tolist() == [100, 101, 102, 103, 104, 105]


def test_an_nwire_recording_keeps_the_wires_before_the_restart(
    tmp_path: Path, make_scenario: Callable[..., Scenario]
) -> None:
    whole = nwire_of(make_scenario(4))
    probe = replace(whole.phantom_from_probe, target="tracker")
    write_poses(probe, tmp_path / "a.igs.mha", probe)
    write_nwire_phantom(tmp_path / "d.xml", whole.phantom, Rigid.identity("tracker", "phantom"))
    twice = np.concatenate([whole.points_px, whole.points_px])
    write_wire_points(tmp_path / "p.xml", "CalibrationData", whole.phantom, twice)
    back = read_nwire_recording(
        tmp_path / "a.igs.mha", tmp_path / "d.xml", tmp_path / "p.xml", "CalibrationData"
    )
    np.testing.assert_array_equal(back.points_px, whole.points_px)
    np.testing.assert_array_equal(back.phantom_from_probe.t_s, probe.t_s)
