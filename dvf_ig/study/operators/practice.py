"""Trials in real time: a person at a haptic device, or a simulated operator at a simulated one.

The servo is that of a live session (`HapticTool`), rules and measures are those of `study operators`.
Each pair of trials is over the same ten pellets, with and without the force, in an order drawn by the seed.
"""

import json
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.operator.hand import perpendicular
from data_synth.operator.held_instrument import HeldInstrument
from data_synth.operator.simulated_operator import RATE_HZ
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid
from dvf_ig.guidance import DEVICES, SupervisorState
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.guidance.devices import HeldDevice, limits_of, open_device, position_mm
from dvf_ig.guidance.devices.catalogue import SIMULATED, VENDORS
from dvf_ig.io import write_text
from dvf_ig.live.haptic import HapticTool
from dvf_ig.report.viewer import SceneInput, scene_payload
from dvf_ig.session import ToolPose
from dvf_ig.study.operators.closed_loop import (
    HAPTICS,
    MONO,
    MONO_NOISE,
    NO_HAPTICS,
    STEREO,
    Aim,
    Condition,
    Loop,
    OperatingHeart,
    Player,
    Trace,
    fixtures_of,
    follow,
    inputs_of,
    operator_of,
    operator_with,
    run_task,
    stylus_of,
)
from dvf_ig.study.operators.pellets import (
    LONGEST_S,
    PELLETS,
    PelletTask,
    cutting_measures,
    dissection_measures,
    pellet_depths_mm,
    pellet_trial,
)
from dvf_ig.study.tracking.stylus import FASTEST_MM_S

SIGHTS = {"mono": MONO, "side-by-side": STEREO, "anaglyph": STEREO}
"""How the page shows the scene, and which of the paper's two kinds of sight that is."""
NO_FORCE_N = 1e-9
"""Largest force of a trial without force at a person's device: its servo runs as ever."""
AXES = {"force-dimension": ("toward", "right", "up"), "openhaptics": ("right", "up", "toward")}
"""Directions of a device's x, y and z, as its maker gives them, seen by who sits before it."""
LOOK_S = 0.001
"""A device reads its button with every 32nd position (Force Dimension), a person presses it for 0.1 s."""
LATE_S = {True: 0.1, False: 0.002}
"""Lateness that latches, by whether the device is simulated: a simulated hand does not feel single ticks."""
REARM_EVERY_S = 0.5
MOST_STEPS = 10
"""Steps that a simulated operator makes at once after the program was held up."""
LOG = "trials.jsonl"
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Practice:
    """Options of a training.

    Attributes:
        task: "cutting" or "dissection".
        device: name, as `open_device` takes it.
        person: who plays, for the table.
        seed: of pellets, fulcra, order, and simulated operator.
        trials: with each of both arms.
        sight: one of SIGHTS.
    """

    task: str
    device: str = SIMULATED
    person: str = "simulated operator"
    seed: int = 1
    trials: int = 1
    sight: str = "mono"

    def __post_init__(self) -> None:
        for what, value, choices in (
            ("task", self.task, ("cutting", "dissection")),
            ("sight", self.sight, tuple(SIGHTS)),
        ):
            if value not in choices:
                raise InvalidInputError(f"{what} '{value}' is none of {', '.join(choices)}")

    @property
    def simulated(self) -> bool:
        """No person plays."""
        return self.device not in VENDORS

    def arms(self, number: int) -> tuple[Condition, Condition]:
        """Conditions of a pair of trials, in the order in which they are played."""
        noise = MONO_NOISE if SIGHTS[self.sight] == MONO else 1.0
        without = Condition(f"{SIGHTS[self.sight]}, {NO_HAPTICS}", haptic=False, noise=noise)
        both = (without, replace(without, name=f"{SIGHTS[self.sight]}, {HAPTICS}", haptic=True))
        return both if child_rng(self.seed, f"order {number}").random() < 0.5 else both[::-1]


class OperatorsHand(HeldInstrument):
    """A simulated operator's hand on a simulated device, as a device that a servo drives in real time."""

    pressed, ends_force_after_s = False, 0.0

    def __init__(self, loop: Loop) -> None:
        stylus = stylus_of(loop.device, loop.condition)
        super().__init__(loop.start_mm, operator_of(loop).hand, stylus, fulcrum=loop.fulcrum)
        self.name = f"simulated {loop.device.name} in a simulated hand"
        self.rate_hz, self.limits = loop.device.rate_hz, loop.limits

    def enable_force(self) -> None:
        """No watchdog switches its forces off."""


class LivePlayer:
    """Who plays in real time: fulfils `Player`; entered while the device's servo runs."""

    def __init__(self, loop: Loop, tool: HapticTool, place: Rigid, instrument: OperatorsHand | None) -> None:
        self._loop, self._tool, self._place, self._instrument = loop, tool, place, instrument
        self._operator = None if instrument is None else operator_with(loop, instrument)
        self._tip_mm = loop.start_mm
        self._steps = 0
        self._begin_s = self._rearmed_s = time.monotonic()

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._begin_s

    @property
    def tip_mm(self) -> FloatArray:
        return self._tip_mm if self._instrument is None else self._instrument.tip_mm

    @property
    def felt_n(self) -> FloatArray:
        return self._tool.sent.force_n if self._instrument is None else self._instrument.felt_n

    @property
    def believed_error_mm(self) -> float:
        return 0.0 if self._operator is None else self._operator.believed_error_mm

    def step(self, aim: Aim) -> float:
        """Publish, let a simulated operator act, and wait for the next step."""
        tool, now_s = self._tool, time.monotonic()
        tool.publish_inputs(inputs_of(self._loop, now_s, begin_s=self._begin_s, place=self._place), now_s)
        due = round(self.now_s * RATE_HZ) + 1
        if self._operator is not None:
            for _ in range(min(due - self._steps, MOST_STEPS)):
                follow(self._operator, aim)
        passed_s, self._steps = (due - self._steps) / RATE_HZ, due
        time.sleep(max(0.0, self._begin_s + due / RATE_HZ - time.monotonic()))
        for event in tool.poses(time.monotonic()):
            pose = event.event
            if isinstance(pose, ToolPose) and pose.tracker_from_tool is not None:
                self._tip_mm = pose.tracker_from_tool[:3, 3]
        if tool.rearm_pressed() or self._rearms(now_s):
            tool.rearm()
        return passed_s if tool.sent.state >= SupervisorState.FADE else 0.0

    def _rearms(self, now_s: float) -> bool:
        """Whether a simulated operator presses the button now."""
        latched = self._tool.sent.state is SupervisorState.LATCHED
        if self._operator is None or not latched or now_s < self._rearmed_s + REARM_EVERY_S:
            return False
        self._rearmed_s = now_s
        return True


def practise(heart: OperatingHeart, practice: Practice, show: "TrainingFeed", tell: Tell, out: Path) -> None:
    """Play all trials, and add each to `out`/trials.jsonl, its course to a CSV file in the same folder.

    Raises:
        InvalidInputError: a device that does not answer, or cannot render the fixtures.
    """
    for number in range(practice.trials):
        for order, condition in enumerate(practice.arms(number)):
            line, trace = _play(heart, practice, condition, number, show, tell)
            line["order"] = order
            stem = f"{1 + len(read_log(out)):03d}-{practice.task}-{practice.person}"
            line["course"] = "".join(c if c.isalnum() or c in "-_" else "_" for c in stem) + ".csv"
            write_text(out / line["course"], _csv(trace))
            with (out / LOG).open("a", encoding="utf-8") as log:
                log.write(json.dumps(line, allow_nan=False) + "\n")


def _play(
    heart: OperatingHeart,
    practice: Practice,
    condition: Condition,
    number: int,
    show: "TrainingFeed",
    tell: Tell,
) -> tuple[dict[str, Any], Trace]:
    device = None if practice.simulated else open_device(practice.device)
    loop, task = _trial(heart, practice, condition, number, device)
    force = "with force" if condition.haptic else "without force"
    show.begin(loop, task, f"{practice.task}, {force}")
    hand, place = None, Rigid.identity("tracker", "device")
    haptic: HeldDevice = (hand := OperatorsHand(loop)) if device is None else device
    tip = Points("tool", np.zeros((1, 3)))
    late_s = LATE_S[device is None]
    with closing(haptic):
        if device is not None:
            tell(f"{force}: hold the stylus still and press its button to begin")
            place = place_of_device(practice.device, loop, tip_at_press_mm(device))
        with HapticTool(haptic, fixtures_of(loop), loop.limits, place, tip, tell, late_s) as tool:
            tell(f"{practice.task}, trial {number + 1} of {practice.trials}, {force}")
            player = LivePlayer(loop, tool, place, hand)
            trace = run_task(loop, task, LONGEST_S, player, lambda t, _: show.observe(t, player, tool))
    measures = cutting_measures if practice.task == "cutting" else dissection_measures
    line = {
        "person": practice.person,
        "task": practice.task,
        "condition": condition.name,
        "trial": number,
        "seed": practice.seed,
        "device": haptic.name,
        "sight": practice.sight,
        "complete": task.done == PELLETS,
        "measures": measures(trace) if task.done > 0 else {},
        "pellet_depths_mm": pellet_depths_mm(trace).round(3).tolist(),
        "latches": list(tool.counts.latches),
    }
    return line, trace


def _trial(
    heart: OperatingHeart,
    practice: Practice,
    condition: Condition,
    number: int,
    device: HeldDevice | None,
) -> tuple[Loop, PelletTask]:
    """Prepare a trial on the device; a person's has no fulcrum, and no force in the arm without."""
    if device is None:
        model = DEVICES[practice.device.partition(":")[2] or next(iter(DEVICES))]
        limits = model.limits(fastest_mm_s=FASTEST_MM_S)
        return pellet_trial(
            heart, practice.task, condition, practice.seed, number=number, device=model, limits=limits
        )
    limits = limits_of(device, COMMON_DEVICE)
    loop, task = pellet_trial(
        heart, practice.task, condition, practice.seed, number=number, limits=limits, fulcrum=False
    )
    if not condition.haptic:
        loop = replace(loop, law=replace(loop.law, cap_n=NO_FORCE_N))
    return loop, task


def place_of_device(name: str, loop: Loop, tip_mm: FloatArray) -> Rigid:
    """Turn a vendor's device to the view, with its tip (3,), frame "device", above the first pellet."""
    toward, up = view_of(loop)
    directions = {"toward": toward, "up": up, "right": np.cross(up, toward)}
    rotation = np.column_stack([directions[axis] for axis in AXES[name]])
    return Rigid("tracker", "device", rotation, loop.start_mm - rotation @ tip_mm)


def view_of(loop: Loop) -> tuple[FloatArray, FloatArray]:
    """Direction (3,) to the eye, and (3,) up in the picture."""
    toward = -loop.sight
    return toward, perpendicular(toward, np.array([0.0, 0.0, 1.0]))


def tip_at_press_mm(device: HeldDevice) -> FloatArray:
    """Wait for a press of the button, and return the tip's place (3,) at it, frame "device".

    No servo runs yet: the button comes with the positions that are read here.
    """
    before, pressed = True, True
    while before or not pressed:
        time.sleep(LOOK_S)
        tip_mm = position_mm(device)
        before, pressed = pressed, device.pressed
    return tip_mm


def _csv(trace: Trace) -> str:
    rows = np.column_stack([trace.t_s, trace.tip_mm, trace.force_n, trace.depth_mm, trace.stage])
    head = "t_s,tip_mr_x_mm,tip_mr_y_mm,tip_mr_z_mm,force_n,depth_mm,stage"
    return "\n".join([head, *(",".join(f"{v:.4f}" for v in row) for row in rows.tolist())]) + "\n"


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Trials of a folder's log; none without a log."""
    path = folder / LOG
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


class TrainingFeed:
    """Data of a running trial for the live page: heart, tool and pellets, and no number that helps.

    The page's thread takes `next_event`; the trial's thread stores references only.
    """

    def __init__(self, heart: OperatingHeart, practice: Practice) -> None:
        loop, _ = pellet_trial(heart, practice.task, practice.arms(0)[0], practice.seed)
        scene = scene_payload(SceneInput("live", f"training: {practice.task}", heart.model, None, None, None))
        toward, up = view_of(loop)
        scene["training"] = {
            "toward": toward.tolist(),
            "up": up.tolist(),
            "sight": practice.sight,
            "pellets": PELLETS,
        }
        self._scene = json.dumps(scene, allow_nan=False).encode()
        self._newest: tuple[float, FloatArray, Loop, PelletTask, SupervisorState, Sequence[str]] | None = None
        self._title, self._sent_s, self._offset_s, self._last_s = "", -1.0, 0.0, 0.0

    def begin(self, loop: Loop, task: PelletTask, title: str) -> None:
        """Show another trial from now on; the page's time goes on."""
        self._loop, self._task, self._title = loop, task, title
        self._offset_s = self._last_s + 1.0

    def observe(self, t_s: float, player: Player, tool: HapticTool) -> None:
        """Store what is shown next."""
        self._last_s = self._offset_s + t_s
        reasons = () if tool.sent.state is SupervisorState.OK else tool.sent.hazards.sentences
        self._newest = (t_s, player.tip_mm, self._loop, self._task, tool.sent.state, reasons)

    def scene(self) -> tuple[bytes, bytes]:
        """Return scene.json, in one part."""
        return self._scene, b""

    def next_event(self) -> str | None:
        """Return what is new since the last call as JSON, or None."""
        if self._newest is None or self._last_s <= self._sent_s:
            return None
        self._sent_s = self._last_s
        t_s, tip_mm, loop, task, state, reasons = self._newest
        phase = loop.heart.phase(loop.condition, t_s)
        moving, count = task.pellets.moving, task.done
        if loop.fulcrum is not None:
            shaft = loop.fulcrum.point_mm - tip_mm
        else:  # seen a little from the side, so that it does not hide its tip
            toward, up = view_of(loop)
            shaft = toward + np.cross(up, toward)
        places = moving.points(phase)[count:]
        if loop.target_depth_mm > 0.0:  # those that wait lie on the surface
            places[1:] += loop.target_depth_mm * np.array([s.normal for s in task.pellets.sites[count + 1 :]])
        event = {
            "t_s": round(self._last_s, 3),
            "phi": phase,
            "phase_valid": 1,
            "model_phase": phase,
            "rr_s": loop.heart.cycle(loop.condition),
            **dict(zip(("tip_mr_x_mm", "tip_mr_y_mm", "tip_mr_z_mm"), tip_mm.round(3).tolist(), strict=True)),
            **dict(zip(("shaft_mr_x", "shaft_mr_y", "shaft_mr_z"), shaft.tolist(), strict=True)),
            "status": "ok",
            "supervisor": state.name.lower(),
            "hazards": "",
            "reasons": list(reasons),
            "pellets": places.round(3).tolist(),
            "rows": [
                ["task", self._title],
                ["pellet", f"{min(count + 1, PELLETS)} of {PELLETS}"],
                ["time", f"{t_s:.0f} s"],
            ],
        }
        return json.dumps(event, allow_nan=False)
