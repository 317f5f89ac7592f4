"""A haptic device as the tool of a live session: its tip, its force, and every way in which that ends."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_library import BROKEN, BUTTON, ENABLES, WATCHDOG, SharedDhd, compiled
from haptic_toy import NEVER_NS, TIP, steady_state, toy_tool
from waiting import heed_interrupts, until

import dvf_ig
from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import DeviceLimits, Hazard, RearmAnswer, SupervisorState
from dvf_ig.guidance.devices import SimulatedStylus, limits_of, open_device
from dvf_ig.guidance.devices.simulated import OMNI, PREMIUM
from dvf_ig.kernels.servo import loop as kernel
from dvf_ig.live.haptic import HapticTool, place_of
from dvf_ig.session import ToolPose

TESTS = Path(__file__).parents[1]
IN_WALL, OUTSIDE = (15.0, 0.0, 0.0), (25.0, 0.0, 0.0)


def patient(tool: HapticTool) -> None:
    """A busy machine makes late ticks: what is no test of lateness allows them."""
    tool._servo._loop.numbers[[kernel.LATE_NS, kernel.SILENT_NS]] = NEVER_NS


def step(tool: HapticTool) -> list[ToolPose]:
    now_s = time.monotonic()
    events = tool.poses(now_s)
    tool.publish(steady_state(now_s))
    time.sleep(0.01)
    return [one.event for one in events if isinstance(one.event, ToolPose)]


@pytest.fixture
def dhd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SharedDhd:
    """A fake Force Dimension device in the ball's wall."""
    import platform

    folder = tmp_path / "lib" / "release" / f"lin-{platform.machine()}-gcc"
    folder.mkdir(parents=True)
    compiled("fake_dhd", folder, "libdhd.so")
    state = SharedDhd(tmp_path / "dhd", IN_WALL)
    monkeypatch.setenv("FORCEDIM_SDK", str(tmp_path))
    monkeypatch.setenv("FAKE_DHD", str(state.path))
    return state


@contextmanager
def driven(told: list[str]) -> Iterator[HapticTool]:
    tool = toy_tool(open_device("force-dimension"), told.append)
    patient(tool)
    with tool:
        yield tool


def test_the_tip_of_a_device_is_the_session_s_tool(dhd: SharedDhd) -> None:
    with driven([]) as tool:
        poses = [pose for _ in range(20) for pose in step(tool)]
    assert len(poses) > 3
    for pose in poses:
        assert pose.by_encoders
        assert pose.tracker_from_tool is not None
        np.testing.assert_allclose(
            pose.tracker_from_tool[:3, :3] @ TIP.xyz_mm[0] + pose.tracker_from_tool[:3, 3], IN_WALL, atol=1e-9
        )
    assert tool.result()["rate_hz"] == 4000.0
    assert tool.result()["ticks"] > 100


def test_an_unplugged_device_has_no_force_after_20_ms_and_latches_with_the_reason(dhd: SharedDhd) -> None:
    told: list[str] = []
    with driven(told) as tool:
        until(lambda: step(tool) is not None and tool.sent.force_n.any())
        tool._servo.read()
        dhd.numbers[BROKEN] = 1
        until(lambda: tool._servo.silent or tool._servo.ticks > 0)
        time.sleep(0.1)
        record = tool._servo.read()
        lost = np.flatnonzero(record.hazards & Hazard.DEVICE_LOST)
        after = record.t_s >= record.t_s[lost[0]] + 0.020
        assert not record.sent_n[after].any()
        assert record.state[-1] == SupervisorState.LATCHED
        until(lambda: step(tool) is not None and tool.sent.state is SupervisorState.LATCHED)
    assert any("does not answer" in sentence for sentence in told)


def test_the_end_of_a_session_is_at_most_one_tick_of_force_more(dhd: SharedDhd) -> None:
    with driven([]) as tool:
        until(lambda: step(tool) is not None and tool.sent.force_n.any())
        tool.withdraw("ended by a test")
        ended_s = time.monotonic()
        tool.withdraw("a second reason")
    late = dhd.log[dhd.log[:, 0] > ended_s]
    assert np.count_nonzero(late[:, 1]) <= 1
    assert dhd.log[-1, 1] == 0.0
    assert tool.ended == "ended by a test"
    assert tool.sent.state is SupervisorState.LATCHED


def test_a_button_rearms_only_below_0_2_n(dhd: SharedDhd) -> None:
    """A watchdog that tripped included: a successor takes the servo's place, latched."""
    told: list[str] = []
    with driven(told) as tool:
        until(lambda: step(tool) is not None and tool.sent.force_n.any())
        tool._servo._loop.numbers[kernel.TRIPPED] = 1
        until(lambda: step(tool) is not None and tool.sent.state is SupervisorState.LATCHED)
        dhd.numbers[BUTTON] = 1
        until(lambda: step(tool) is not None and tool.rearm_pressed())
        assert tool.rearm() is RearmAnswer.FORCE_WANTED
        patient(tool)
        assert not tool._servo.watchdog_tripped
        assert dhd.numbers[ENABLES] == 3, "opened, first servo, its successor"
        step(tool)
        assert tool.sent.state is SupervisorState.LATCHED
        dhd.numbers[:3] = 1e-3 * np.array(OUTSIDE)
        dhd.numbers[BUTTON] = 0
        until(lambda: step(tool) is not None and not tool.device.pressed)
        assert not tool.rearm_pressed()
        dhd.numbers[BUTTON] = 1
        until(lambda: step(tool) is not None and tool.rearm_pressed())
        until(lambda: tool.rearm() in (RearmAnswer.ACCEPTED, RearmAnswer.NOT_LATCHED))
        until(lambda: step(tool) is not None and tool.sent.state is not SupervisorState.LATCHED)
    assert any("0.2 N" in sentence for sentence in told)
    assert any("is re-armed" in sentence for sentence in told)


class Program:
    """The program of `haptic_program.py` with a fake device."""

    def __init__(self, dhd: SharedDhd) -> None:
        paths = (TESTS / "toys", Path(dvf_ig.__file__).parents[1])
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("haptic_program.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "FAKE_DHD": str(dhd.path)},
            preexec_fn=heed_interrupts,
        )
        said: Any = self.process.stdout
        while (line := said.readline().strip()) != "ready":
            assert self.process.poll() is None, line

    def end(self, number: signal.Signals) -> tuple[float, str]:
        """When the signal was sent, and what was said until the end."""
        sent_s = time.monotonic()
        self.process.send_signal(number)
        said, _ = self.process.communicate(timeout=60)
        return sent_s, said


def test_a_signal_ends_the_force_and_the_reason_is_said(dhd: SharedDhd) -> None:
    _, said = Program(dhd).end(signal.SIGTERM)
    assert "ended by SIGTERM" in said
    assert dhd.log[-1, 1] == 0.0
    assert dhd.log[:, 1].any()


def test_a_killed_program_leaves_a_device_that_ends_the_force_itself(dhd: SharedDhd) -> None:
    program = Program(dhd)
    program.end(signal.SIGKILL)
    assert dhd.numbers[WATCHDOG] * 125e-6 == 0.015
    count = len(dhd.log)
    time.sleep(0.05)
    assert len(dhd.log) == count


def test_limits_are_the_smaller_of_what_device_and_user_state() -> None:
    device = SimulatedStylus(OMNI, np.zeros(3))
    assert limits_of(device, DeviceLimits()).continuous_force_n == 0.88
    stated = DeviceLimits(stiffness_n_per_m=300.0, continuous_force_n=3.0, name="ours")
    both = limits_of(device, stated)
    assert (both.stiffness_n_per_m, both.continuous_force_n) == (300.0, 0.88)
    premium = SimulatedStylus(PREMIUM, np.zeros(3)).limits
    assert premium.stiffness_n_per_m == pytest.approx(1000 * 2 * (0.005e-3 * 200 + 0.038) / (0.2 + 0.03))


def test_a_simulated_device_needs_no_place_and_follows_the_tool() -> None:
    device = open_device("simulated:omni")
    told: list[str] = []
    assert place_of(device, None).matrix.tolist() == np.eye(4).tolist()
    tool = toy_tool(device, told.append)
    patient(tool)
    with tool:
        assert step(tool) == []
        pose = np.eye(4)
        pose[:3, 3] = np.array(OUTSIDE) - TIP.xyz_mm[0]
        tool.follow(ToolPose(time.monotonic(), pose))
        poses = [one for _ in range(30) for one in step(tool)]
    assert poses[-1].tracker_from_tool is not None
    np.testing.assert_allclose(poses[-1].tracker_from_tool[:3, 3], pose[:3, 3], atol=1.0)
    assert told == []


def test_another_device_needs_a_place(dhd: SharedDhd) -> None:
    device = open_device("force-dimension")
    with pytest.raises(InvalidInputError, match="calibrate device"):
        place_of(device, None)
    device.close()
    with pytest.raises(InvalidInputError, match="needed one of force-dimension"):
        open_device("falcon")
