"""Press every kind of tissue with simulated devices: stiffness commanded and rendered, tissues distinguished.

A slow hand presses a wall of one tissue, still and beating, with a simulated PHANToM Premium and Omni. The
rendered stiffness is the slope of the hand's own force over the tip's depth while it presses: friction of the
device moves the force, not its slope. Simulated operators then compare tissues by the force that they feel at
the same depth, less that of moving freely, in three presses; their readings of force and depth have standard
deviations of 7 and 5 % (assumed, after Weber fractions of force). Nothing here says what a person feels.

    dvf-ig study tissue
    dvf-ig study tissue --operators 500
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, Grid, Rigid, Tissue, Volume, Warp, read_only_arrays
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.guidance import DEVICES
from dvf_ig.guidance.device import COMMON_DEVICE, MM_PER_M
from dvf_ig.guidance.devices import limits_of
from dvf_ig.guidance.devices.simulated import Hand, SimulatedStylus
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo
from dvf_ig.guidance.tissue import FEEL_CAP_N, TISSUES, TissueClass, feel_fixtures, feel_of
from dvf_ig.study.driver import Driver, Result, Rows, Study
from dvf_ig.study.options import option, seed_option
from dvf_ig.study.passivity import steady_transform, wall_model

FORCE_WEBER, DEPTH_WEBER, PRESSES = 0.07, 0.05, 3
DEEPEST_MM, APPROACH_MM, SPEED_MM_S = 6.0, 2.0, 8.0
MEASURED_MM, BELOW_CAP = (1.0, 5.0), 0.9
"""Depths between which the slope is taken, while the force is below this share of its cap."""
HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M = 600.0, 6.0
BLOCK_TICKS = 5
BEATING_MM = 5.0
APART_RATIO, APART_SHARE = 2.0, 0.95


@dataclass(frozen=True, kw_only=True)
class TissueSettings:
    """Options of the study."""

    operators: int = option("How many simulated operators compare each pair of tissues.", 200, least=1)
    seed: int = seed_option(1)


def tissue_wall(names: Iterable[str], amplitude_mm: float = 0.0) -> DvfModel:
    """Build `wall_model` with tissue: slabs along y, of equal width, which the wall's motion carries."""
    model = wall_model(amplitude_mm)
    listed = tuple(enumerate(names, start=1))
    low = np.full(3, -30.0)
    grid = Grid.axis_aligned(model.frame, (13, 49, 13), np.array([-30.0, -30.0, -30.0]), 1.25)
    slab = 1 + np.minimum(np.arange(49) * len(listed) // 49, len(listed) - 1)
    labels = Volume(grid, np.broadcast_to(slab[None, :, None], grid.shape).astype(np.uint8))
    places = knots(low, 60.0 / CELLS)
    phases = np.arange(model.phases) / model.phases
    motion = []
    for shift_mm in (0.5 * amplitude_mm * (1.0 - np.cos(2.0 * np.pi * phases))).tolist():
        pull_mm = np.tile([shift_mm, 0.0, 0.0], (len(places), 1))
        motion.append(Warp.through(model.frame, low, 60.0 / CELLS, pull_mm, np.zeros(len(places))))
    return replace(model, tissue=Tissue(labels, listed, tuple(motion)))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One press: depth of the tip below the surface and force of the hand, with the servo's record.

    Attributes:
        depth_mm, hand_n: (n,) at each block, while the hand goes in.
        record: of all ticks.
    """

    depth_mm: FloatArray
    hand_n: FloatArray
    record: ServoRecord

    @property
    def stiffness_n_per_mm(self) -> float:
        """Slope of the hand's force over depth."""
        sent_n = np.linalg.norm(self.record.sent_n, axis=1)[BLOCK_TICKS - 1 :: BLOCK_TICKS]
        inside = (self.depth_mm > MEASURED_MM[0]) & (self.depth_mm < MEASURED_MM[1])
        inside &= sent_n < BELOW_CAP * FEEL_CAP_N
        return float(np.polyfit(self.depth_mm[inside], self.hand_n[inside], 1)[0])

    def felt_n(self, deep_mm: float) -> tuple[float, float]:
        """Force of the hand before it touches, and at a depth."""
        free = self.depth_mm < -0.25 * APPROACH_MM
        return float(np.median(self.hand_n[free])), float(np.interp(deep_mm, self.depth_mm, self.hand_n))


def press(model: DvfModel, name: str) -> Press:
    """Let a hand press a simulated device into a still tissue, slowly, until it is DEEPEST_MM deep."""
    run = _Feeling(model, name, -2.0 * APPROACH_MM)
    depth, force = [], []
    target, last = -2.0 * APPROACH_MM, run.tip_mm
    while run.tip_mm < DEEPEST_MM + 0.3:
        target += SPEED_MM_S * run.step_s
        run.hold(target)
        depth.append(0.5 * (run.tip_mm + last))
        speed = (run.tip_mm - last) / run.step_s
        hand = HAND_STIFFNESS_N_PER_M * (target - depth[-1]) - HAND_DAMPING_N_S_PER_M * speed
        force.append(hand / MM_PER_M)
        last = run.tip_mm
    return Press(np.array(depth), np.array(force), run.record)


def rest(model: DvfModel, name: str, seconds: float = 3.0) -> ServoRecord:
    """Rest a hand on a beating tissue, half of its motion deep."""
    run = _Feeling(model, name, 0.0)
    while run.now_s < seconds:
        run.hold(0.5 * BEATING_MM)
    return run.record


class _Feeling:
    """A simulated device at a wall of tissue, with a hand on it."""

    def __init__(self, model: DvfModel, name: str, start_mm: float) -> None:
        self._stylus = SimulatedStylus(DEVICES[name], np.array([start_mm, 0.0, 0.0]))
        limits = limits_of(self._stylus, COMMON_DEVICE)
        options = ServoOptions(feel=feel_of(model, limits))
        fixtures = feel_fixtures(model, limits)
        self._servo = SimulatedServo(fixtures, self._stylus, limits=limits, options=options)
        self._transform, self._place = steady_transform(model), Rigid.identity("tracker", "device")
        self._rows: list[Any] = []
        self.step_s = BLOCK_TICKS / DEVICES[name].rate_hz

    def hold(self, target_mm: float) -> None:
        """Run one block with the hand's spring at a place along the wall's normal."""
        place = np.array([target_mm, 0.0, 0.0])
        self._stylus.hold(Hand(np.zeros(3), place, HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M))
        inputs = ServoInputs(self._transform, self.now_s, self._place, valid_for_s=60.0)
        self._rows.append(self._servo.run(inputs, BLOCK_TICKS).rows)

    @property
    def now_s(self) -> float:
        return self._servo.now_s

    @property
    def tip_mm(self) -> float:
        """True tip along the wall's normal."""
        return float(self._stylus.position_mm[0])

    @property
    def record(self) -> ServoRecord:
        return ServoRecord(np.concatenate(self._rows))


def correct_share(soft: Press, stiff: Press, operators: int, rng: np.random.Generator) -> float:
    """Compute the share of operators who call the stiffer of two tissues so.

    Both are pressed equally deep, to DEEPEST_MM or where the stiffer nears the largest force.
    """
    guesses, deep_mm = [], min(DEEPEST_MM, BELOW_CAP * FEEL_CAP_N / stiff.stiffness_n_per_mm)
    for one in (soft, stiff):
        free_n, deep_n = one.felt_n(deep_mm)
        size = (operators, PRESSES)
        deep = deep_n * (1.0 + FORCE_WEBER * rng.standard_normal(size))
        free = free_n * (1.0 + FORCE_WEBER * rng.standard_normal(size))
        depth = deep_mm * (1.0 + DEPTH_WEBER * rng.standard_normal(size))
        guesses.append(((deep - free) / depth).mean(axis=1))
    return float((guesses[1] > guesses[0]).mean())


def run(settings: TissueSettings, driver: Driver) -> Result:
    """Press every tissue on every device."""
    rng = np.random.default_rng(settings.seed)
    rendered: list[dict[str, Any]] = []
    pairs: list[dict[str, Any]] = []
    for name in DEVICES:
        presses = {one: press(tissue_wall([one.words[0]]), name) for one in TISSUES}
        rendered += [_rendered(name, one, presses[one]) for one in TISSUES]
        for soft, stiff in combinations(TISSUES, 2):
            ratio = stiff.stiffness_n_per_mm / soft.stiffness_n_per_mm
            if ratio >= APART_RATIO:
                share = correct_share(presses[soft], presses[stiff], settings.operators, rng)
                pairs.append(
                    {
                        "device": name,
                        "soft": soft.name,
                        "stiff": stiff.name,
                        "ratio": ratio,
                        "correct_share": share,
                    }
                )
    fields = {
        "rendered": rendered,
        "pairs": pairs,
        "correct_share": {name: _mean(pairs, name) for name in DEVICES},
        "pairs_apart": {name: _mean(pairs, name, APART_SHARE) for name in DEVICES},
    }
    return Result(fields, [*_rendered_rows(rendered), *_pair_rows(fields)], {"tissue.json": fields})


def _mean(pairs: Sequence[Mapping[str, Any]], device: str, least: float | None = None) -> float:
    """Average the shares of a device, or count those of at least `least`."""
    shares = np.array([pair["correct_share"] for pair in pairs if pair["device"] == device])
    return float((shares if least is None else shares >= least).mean())


def _rendered(name: str, one: TissueClass, still: Press) -> dict[str, Any]:
    limits = limits_of(SimulatedStylus(DEVICES[name], np.zeros(3)), COMMON_DEVICE)
    beating = rest(tissue_wall([one.words[0]], BEATING_MM), name)
    commanded = min(one.stiffness_n_per_mm, limits.allowed_stiffness_n_per_mm)
    return {
        "device": name,
        "tissue": one.name,
        "table_n_per_mm": one.stiffness_n_per_mm,
        "commanded_n_per_mm": commanded,
        "rendered_n_per_mm": still.stiffness_n_per_mm,
        "error": still.stiffness_n_per_mm / commanded - 1.0,
        "largest_residual_mj": float(max(still.record.residual_mj.max(), beating.residual_mj.max())),
        "beating_states": np.unique(beating.state).tolist(),
    }


def _rendered_rows(rendered: Sequence[Mapping[str, Any]]) -> Rows:
    rows: Rows = [("device", "tissue", "commanded N/mm", "rendered", "error", "largest residual mJ")]
    for one in rendered:
        numbers = (f"{one['commanded_n_per_mm']:.3f}", f"{one['rendered_n_per_mm']:.3f}")
        error = f"{100.0 * one['error']:+.1f} %"
        rows.append((one["device"], one["tissue"], *numbers, error, f"{one['largest_residual_mj']:.3f}"))
    return rows


def _pair_rows(fields: Mapping[str, Any]) -> Rows:
    rows: Rows = [("device", "pair least apart", "ratio", "operators right", "mean", "pairs apart by 95 %")]
    for name, mean in fields["correct_share"].items():
        worst = min(
            (pair for pair in fields["pairs"] if pair["device"] == name),
            key=lambda pair: pair["correct_share"],
        )
        pair = f"{worst['soft']}, {worst['stiff']}"
        shares = (f"{worst['correct_share']:.1%}", f"{mean:.1%}", f"{fields['pairs_apart'][name]:.0%}")
        rows.append((name, pair, f"{worst['ratio']:.1f}", *shares))
    return rows


STUDY = Study(TissueSettings, run, outputs=lambda _: ("tissue.json",), trials=False, needs_folder=False)
