"""Stylus held to the moving surface by a guidance fixture alone: how far from the true surface it is.

The stylus belongs to a simulated haptic device that nobody touches. It starts on the surface at rest, at
several places; the fixture's model is fitted to the true surface at some phases of the cycle, and the truth
is the phantom's motion between them. Time and phase are known exactly, and there is no registration: what
is left is the fixture, its blending, and the mass and friction of the device.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from data_synth import MotionPreset, MovingSurface, phantom_anatomy
from dvf_ig.core import CycleTiming, DvfModel, InvalidInputError, Rigid, SurfaceSeries
from dvf_ig.core.arrays import FloatArray, IntArray, read_only_arrays
from dvf_ig.guidance import Evaluator, FeedForward, Gaussian, SimulatedDevice, Status, tightest_gaussian
from dvf_ig.guidance.blend import Blend
from dvf_ig.kernels.device import MM_PER_M, advance
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.preop import ModelOptions, model_from_surfaces

FASTEST_MM_S = 150.0
"""Passivity is asked for up to this speed; a physiological surface reaches 100 mm/s in a 0.6 s cycle."""
COMPENSATED = 0.75
"""Share of the device's dry friction that the feed-forward overcomes; the rest is for what is not known."""
PHASE_STEP = 0.01
"""Half the span, in cycles, of the difference that gives the speed of the surface."""
SPEED_CUTOFF_HZ = 50.0
"""Cut-off of the filter on the stylus' measured speed: a sensor step in 1 ms alone is 30 to 55 mm/s."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatingSurface:
    """A beating heart: its true surface, the model fitted to some phases, and where the stylus is put.

    Attributes:
        motion: preset.
        truth: the surface at every phase.
        model: dynamic fixture.
        starts_mm: (k, 3) points of the surface at phase 0.
        excursion_mm: (k,) how far the surface moves along its normal there.
    """

    motion: MotionPreset
    truth: MovingSurface
    model: DvfModel
    starts_mm: FloatArray
    excursion_mm: FloatArray


@dataclass(frozen=True, slots=True)
class HeldStylus:
    """A device with the fixture that holds its stylus to the surface."""

    device: SimulatedDevice
    law: Gaussian
    blend: Blend
    feed_forward: FeedForward


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class StylusRun:
    """Motion of a stylus over the cycles, from each place on.

    Attributes:
        stylus: what was held.
        t_s: (n,) from the start on.
        tip_mm: (k, n, 3) true tip.
        force_n: (k, n, 3) commanded.
        distance_mm: (k, n) signed distance of the tip to the true surface, positive inside.
        outward: (k, 3) mean direction out of the organ at the tip.
    """

    stylus: HeldStylus
    t_s: FloatArray
    tip_mm: FloatArray
    force_n: FloatArray
    distance_mm: FloatArray
    outward: FloatArray

    def summary(self) -> dict[str, float]:
        """Statistics of |distance| over all places and times; how far the stylus slid; the largest force.

        The slide is that between begin and end of the whole cycles at the place of the largest slide: nothing
        holds the stylus sideways.
        """
        error = np.abs(self.distance_mm)
        slid = np.linalg.norm(self.tip_mm[:, -1] - self.tip_mm[:, 0], axis=1)
        return {
            "mean_mm": float(error.mean()),
            "rms_mm": float(np.sqrt((error**2).mean())),
            "p95_mm": float(np.percentile(error, 95)),
            "max_mm": float(error.max()),
            "worst_place_mean_mm": float(error.mean(axis=1).max()),
            "slid_mm": float(slid.max()),
            "largest_force_n": float(np.linalg.norm(self.force_n, axis=2).max()),
        }


def beating_surface(
    motion: MotionPreset,
    *,
    phases: int = 20,
    cycle_s: float = 0.6,
    places: int = 6,
    seed: int = 1,
    knot_spacing_mm: float = 3.0,
    progress: Callable[[float], None] | None = None,
) -> BeatingSurface:
    """The phantom's epicardium, and places spread over the half of it that moves more.

    Args:
        motion: "paper5mm" or "physiological".
        phases: volumes of the model, evenly spread over the cycle (the paper: 20).
        cycle_s: length of the cycle (the paper: 20 × T_d = 0.6 s).
        places: number of starting points; the last is where the surface moves most.
        seed: of the phantom's shape.
        progress: told the share of the model that is fitted.
    Raises:
        InvalidInputError: unknown motion, or fewer than 2 phases or 1 place.
    """
    if places < 1:
        raise InvalidInputError(f"{places} places asked for; needed at least 1")
    anatomy = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed)
    timing = CycleTiming.uniform(phases, cycle_s)
    vertices = np.stack([anatomy.surface_vertices(phase) for phase in timing.fractions.tolist()])
    series = SurfaceSeries("EPICARDIAL", "mr", vertices, anatomy.surface_triangles, timing, f"phantom-{seed}")
    options = ModelOptions(knot_spacing_mm=knot_spacing_mm)
    model = model_from_surfaces(series, options=options, progress=progress)
    truth = MovingSurface.of(anatomy)
    excursion = _normal_excursion(vertices, anatomy.surface_triangles)
    ranks = np.linspace(1.0, 0.5, places, endpoint=False)[::-1] if places > 1 else np.ones(1)
    chosen = np.argsort(excursion, kind="stable")[np.round(ranks * (len(excursion) - 1)).astype(int)]
    return BeatingSurface(motion, truth, model, vertices[0][chosen], excursion[chosen])


def with_fixture(
    device: SimulatedDevice, blend: Blend, *, compensate: bool, cap_n: float = 0.6
) -> HeldStylus:
    """The fixture of smallest dead band that the device renders passively; nothing is tuned to this study.

    Args:
        device: whose stylus is to be held.
        blend: of the fixture.
        compensate: whether the surface's known speed is used to overcome dry friction.
        cap_n: largest force (the paper: 0.6 N).
    """
    feed_forward = FeedForward(friction_n=spare_friction_n(device) if compensate else 0.0)
    limits = device.limits(fastest_mm_s=FASTEST_MM_S, feed_forward=feed_forward)
    friction_n = device.dry_n - feed_forward.friction_n
    return HeldStylus(device, tightest_gaussian(friction_n, cap_n=cap_n, device=limits), blend, feed_forward)


def spare_friction_n(device: SimulatedDevice) -> float:
    """Dry friction that may be compensated: what passivity at full stiffness can do without.

    From K = 2(bv + c)/(vT + Δ), see `DeviceLimits`, at the fastest speed.
    """
    limits = device.limits(fastest_mm_s=FASTEST_MM_S)
    stiffness = limits.stiffness_n_per_m / MM_PER_M
    needed = 0.5 * stiffness * (FASTEST_MM_S / device.rate_hz + device.resolution_mm)
    needed -= device.viscous_n_s_per_m / MM_PER_M * FASTEST_MM_S
    return min(COMPENSATED * device.dry_n, max(0.0, device.dry_n - needed))


def held_styli(devices: Sequence[SimulatedDevice], blends: Sequence[Blend]) -> list[HeldStylus]:
    """Each device with each blend, and again with feed-forward where a tenth of its friction is to spare."""
    out = []
    for device in devices:
        helped = spare_friction_n(device) > 0.1 * device.dry_n
        for compensate in (False, True) if helped else (False,):
            out += [with_fixture(device, blend, compensate=compensate) for blend in blends]
    return out


def hold_stylus(surface: BeatingSurface, stylus: HeldStylus, *, cycles: int = 30) -> StylusRun:
    """Let the fixture hold the device to the surface for some cycles, at each place.

    Raises:
        InvalidInputError: fewer than 1 cycle, or a law beyond the device's limits.
    """
    if cycles < 1:
        raise InvalidInputError(f"{cycles} cycles asked for; needed at least 1")
    device, cycle_s = stylus.device, surface.model.timing.rr_s
    limits = device.limits(fastest_mm_s=FASTEST_MM_S, feed_forward=stylus.feed_forward)
    evaluator = Evaluator(surface.model, stylus.law, blend=stylus.blend, device=limits)
    tick = partial(force_tick, *evaluator.kernel_arguments(Rigid.identity("mr", "device")))
    t_s = np.arange(round(cycles * cycle_s * device.rate_hz)) / device.rate_hz
    shape = (len(surface.starts_mm), len(t_s), 3)
    tip, force, distance, outward = np.empty(shape), np.empty(shape), np.empty(shape[:2]), []
    for i, start in enumerate(surface.starts_mm):
        tip[i], force[i] = _one_place(tick, stylus, start, t_s / cycle_s, cycle_s)
        distance[i], gradient = surface.truth.distance(tip[i], t_s / cycle_s)
        outward.append(-gradient.mean(axis=0) / np.linalg.norm(gradient.mean(axis=0)))
    return StylusRun(stylus, t_s, tip, force, distance, np.array(outward))


def pool_hearts(runs: Sequence[StylusRun]) -> StylusRun:
    """Pool runs of one stylus on several hearts."""
    return StylusRun(
        runs[0].stylus,
        runs[0].t_s,
        np.concatenate([run.tip_mm for run in runs]),
        np.concatenate([run.force_n for run in runs]),
        np.concatenate([run.distance_mm for run in runs]),
        np.concatenate([run.outward for run in runs]),
    )


def _one_place(
    tick: partial[int], stylus: HeldStylus, start_mm: FloatArray, phase: FloatArray, cycle_s: float
) -> tuple[FloatArray, FloatArray]:
    """Tip (n, 3) and force (n, 3) at every tick: measure, evaluate, add the feed-forward, cap, move."""
    device, law, constants = stylus.device, stylus.law, stylus.device.constants
    state = np.concatenate([start_mm, np.zeros(3)])
    tip, force = np.empty((len(phase), 3)), np.zeros((len(phase), 3))
    out, speed, last = np.empty(7), np.zeros(3), device.measured_mm(start_mm)
    share = 1.0 - np.exp(-2.0 * np.pi * SPEED_CUTOFF_HZ / device.rate_hz)
    for k, phi in enumerate(phase.tolist()):
        tip[k] = state[:3]
        here = device.measured_mm(tip[k])
        speed += share * ((here - last) * device.rate_hz - speed)
        last = here
        if tick(here, phi, int(Status.OK), out) == Status.OK:
            force[k] = out[:3]
            if stylus.feed_forward != FeedForward():
                gradient = out[4:].copy()
                rate = _distance_rate(tick, here, phi, out) / cycle_s
                force[k] += stylus.feed_forward.force(gradient, rate, speed)
                force[k] *= min(1.0, law.cap_n / max(float(np.linalg.norm(force[k])), law.cap_n))
        advance(state, force[k], *constants, state)
    return tip, force


def _distance_rate(tick: partial[int], here: FloatArray, phi: float, out: FloatArray) -> float:
    """∂d/∂φ at a point that stays, mm a cycle."""
    tick(here, phi + PHASE_STEP, int(Status.OK), out)
    after = float(out[3])
    tick(here, phi - PHASE_STEP, int(Status.OK), out)
    return (after - float(out[3])) / (2.0 * PHASE_STEP)


def _normal_excursion(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """(v,) furthest each vertex moves along its normal at phase 0; vertices (n, v, 3)."""
    a, b, c = (vertices[0][triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices[0])
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return np.asarray(np.abs(np.einsum("nvi,vi->nv", vertices - vertices[0], normals)).max(axis=0))
