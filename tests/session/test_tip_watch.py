"""Frames and tool poses that arrived become sightings of the tip, beat by beat."""

import numpy as np
import pytest

from dvf_ig.core import Fan, ImageMap, Points, Rigid
from dvf_ig.session import CalibrationsInUse, ToolPose, TrackedFrame
from dvf_ig.session.arrived_ultrasound import FrameBuffer
from dvf_ig.session.tip_watch import TipWatch

ROWS, COLUMNS, MM = 120, 120, 0.5
TIP_MM = np.array([5.0, 0.0, 40.0])
LAG_S = 0.05
FAN = Fan(np.array([60.0, -200.0]), 190.0, 330.0, 0.4)


def calibrations(off_mm: float = 0.0) -> CalibrationsInUse:
    """The image's calibration is wrong by `off_mm` along its columns."""
    rigid = Rigid("probe", "image", np.eye(3), np.array([-30.0 + off_mm, 0.0, 0.0]))
    tip = Points("tool", TIP_MM[None])
    return CalibrationsInUse(probe_from_image=ImageMap(rigid, np.full(2, MM)), lag_s=LAG_S, tip=tip)


def place_mm(t_s: float) -> np.ndarray:
    """Path of the tip past a probe at rest: through the image now and then, never at rest."""
    return np.array([4.0 * np.sin(t_s), 30.0 + 3.0 * np.cos(1.3 * t_s), 7.5 * np.sin(0.9 * t_s)])


def frame(t_s: float, rng: np.random.Generator, *, shown: bool) -> TrackedFrame:
    """Image of the tip at t_s + LAG_S; the tool is as bright as it is near to the plane."""
    x, y, z = place_mm(t_s + LAG_S)
    row, column = np.mgrid[:ROWS, :COLUMNS] * MM
    near = np.exp(-0.5 * (z / 1.5) ** 2) if shown else 0.0
    spot = 160.0 * near * np.exp(-0.5 * ((column - 30.0 - x) ** 2 + (row - y) ** 2) / 1.0**2)
    grey = 60.0 + 15.0 * rng.standard_normal(row.shape) + spot
    return TrackedFrame(t_s, np.clip(grey, 0, 255).astype(np.uint8), np.eye(4))


def watched(
    *, shown: bool = True, off_mm: float = 0.0, fan: Fan | None = FAN, until_s: float = 16.0
) -> list[float | None]:
    """How far off the tip is seen after each beat of 0.8 s."""
    rng, buffer = np.random.default_rng(4), FrameBuffer()
    watch = TipWatch(buffer, calibrations(off_mm), fan)
    for t_s in np.arange(0.0, until_s, 1 / 12):
        buffer.push(frame(float(t_s), rng, shown=shown))
    for t_s in np.arange(0.0, until_s, 0.01):
        pose = np.eye(4)
        pose[:3, 3] = place_mm(float(t_s)) - TIP_MM
        watch.push(ToolPose(float(t_s), pose))
    out: list[float | None] = []
    for beat_s in np.arange(0.8, until_s - 0.8, 0.8):
        seen = watch.after_beat(float(beat_s), float(beat_s) + 0.15)
        out.append(None if seen is None else seen.off_mm)
    return out


@pytest.mark.parametrize("fan", [FAN, None])
def test_the_tip_is_seen_where_it_should_be(fan: Fan | None) -> None:
    off_mm = [off for off in watched(fan=fan) if off is not None]
    assert off_mm
    assert max(off_mm) <= 1.0


def test_a_wrong_image_calibration_shows() -> None:
    off_mm = [off for off in watched(off_mm=6.0) if off is not None]
    assert off_mm
    assert off_mm[-1] == pytest.approx(6.0 - 1.0, abs=1.0)


def test_a_tool_that_is_not_shown_says_nothing() -> None:
    assert set(watched(shown=False)) == {None}


def test_nothing_is_looked_at_before_it_is_known() -> None:
    rng, buffer = np.random.default_rng(4), FrameBuffer()
    watch = TipWatch(buffer, calibrations(), FAN)
    for t_s in np.arange(0.0, 16.0, 1 / 12):
        buffer.push(frame(float(t_s), rng, shown=True))
    for t_s in np.arange(0.0, 16.0, 0.01):
        pose = np.eye(4)
        pose[:3, 3] = place_mm(float(t_s)) - TIP_MM
        watch.push(ToolPose(float(t_s), pose))
    # all frames and poses are there, but at 0.1 s only those up to then count
    assert watch.after_beat(15.0, 0.1) is None


def test_poses_that_cannot_be_used_are_left_out() -> None:
    buffer, rng = FrameBuffer(), np.random.default_rng(0)
    watch = TipWatch(buffer, calibrations(), FAN)
    for t_s in np.arange(0.0, 4.0, 1 / 12):
        buffer.push(frame(float(t_s), rng, shown=True))
    assert watch.after_beat(1.0, 1.2) is None
    watch.push(ToolPose(1.3, None))
    watch.push(ToolPose(1.4, np.full((4, 4), np.nan)))
    watch.push(ToolPose(1.2, np.eye(4)))
    assert watch.after_beat(2.0, 2.2) is None
