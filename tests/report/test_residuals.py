"""Figures of calibration residuals and of latency: written whole, or refused with the reason."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.calibration import estimate_latency
from dvf_ig.core import InvalidInputError, LatencyRecording, PoseStream, Trace
from dvf_ig.report import write_latency_picture, write_residual_picture


def picture_size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def test_residual_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = rng.rayleigh(0.3, 200)
    values[:20] = 60.0
    values[30] = np.nan
    write_residual_picture(tmp_path / "dots.png", values, title="Tip: 0.4 mm", used=values < 3.0)
    names = [f"#{i}" for i in range(8)]
    write_residual_picture(
        tmp_path / "bars.png", values[100:108], title="8 landmarks", names=names, second=values[110:118]
    )
    assert picture_size(tmp_path / "dots.png")[0] > 1000
    assert picture_size(tmp_path / "bars.png")[1] > 400
    with pytest.raises(InvalidInputError, match="no finite residual"):
        write_residual_picture(tmp_path / "x.png", np.full(3, np.nan), title="")
    with pytest.raises(InvalidInputError, match="2 names for 3 residuals"):
        write_residual_picture(tmp_path / "x.png", np.ones(3), title="", names=["a", "b"])
    with pytest.raises(InvalidInputError, match=r"does not end in \.png"):
        write_residual_picture(tmp_path / "x.jpg", np.ones(3), title="")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bars.png", "dots.png"]


def test_latency_picture(tmp_path: Path) -> None:
    tracker_t, video_t = np.arange(-1.0, 19.0, 1 / 46), np.arange(0.0, 17.0, 1 / 12)

    def depth(
        t_s: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.asarray(12 * np.sin(2 * np.pi * (t_s / 1.03 + 0.2 * np.sin(0.9 * t_s))))

    moved = np.column_stack([0 * tracker_t, 0 * tracker_t, depth(tracker_t)])
    turns = np.tile(np.eye(3), (len(tracker_t), 1, 1))
    poses = PoseStream("tracker", "probe", tracker_t, turns, moved, np.ones(len(tracker_t), bool))
    found = estimate_latency(LatencyRecording(poses, Trace(video_t, 300 + 10 * depth(video_t - 0.05))))
    write_latency_picture(tmp_path / "lag.png", found, title="Lag -50 ms")
    assert picture_size(tmp_path / "lag.png")[0] > 1000
