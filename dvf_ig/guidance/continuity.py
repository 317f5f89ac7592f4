"""Continuity of a fixture's force in position and phase: Lipschitz bounds, and a search for violations.

The fields of a model are splines, so bounds come from their coefficients. With knot pitch h, differences Δ
of neighbouring coefficients and the convexity of B-splines, |∂_a d| <= max|Δ_a c|/h and |∂_ab d| <=
max|Δ_a Δ_b c|/h². Hence
    G >= |∇d|    root of the sum of the squared bounds over a;
    H >= ‖∇²d‖   the same over a, b (Frobenius norm);
    D >= |∂d/∂φ| and Γ >= |∂∇d/∂φ| from differences between phases: Δ_φ c over the time between them for the
                 linear blends, 3 Δ_φ b_j / (t_{j+1} − t_{j−2}) for the periodic spline's coefficients b_j.
Of the law, with cap F and s the distance below the guarded depth s₀: |f| <= 1, K >= |f'|,
    T >= |d f'(d − s₀)|, namely sup|s f'(s)| + |s₀|K: 0.2239 + |s₀|K for sigmoids, 2m/e + |s₀|K for Gaussians.
Of the fade σ = smoothstep(r, 0.2, 0.4), r = |∇d|: σ <= 1, σ/r <= S = 2.56, and the faded direction σ(r)∇d/r
is Lipschitz in ∇d with E = max(σ', σ/r) = σ'(0.3) = 7.5.

`force` blend: each phase's F·f·σ∇d/r has |∂/∂q| <= F(K G + E H), and a convex combination no more. In phase
the slope is a difference of two forces over the time between them: at most F(K D + E Γ), and 2F/width.
`distance` and `periodic`: the law is given d/r, |∂(d/r)/∂q| <= 1 + |d|H/r². With σ/r <= S, |d f'|/r <= T,
|∂F/∂q| <= F(K + S T H + E H); likewise |∂F/∂φ| <= F(S K D + S T Γ + E Γ).
The bounds hold inside the model's box; at its border a force that has not died away ends.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.laws import SIGMOID

from .evaluator import Evaluator
from .places import Status

DIRECTION_LIPSCHITZ = 7.5
"""E."""
FADE_OVER_NORM = 2.56
"""S."""
SIGMOID_SLOPE_TIMES_DISTANCE = 0.22388
"""sup of x eˣ/(1 + eˣ)²."""
LARGEST_STEP_MM = 0.3
SMALLEST_STEP_MM = 1e-7
PHASE_STEP = 0.02
"""Largest step in phase, cycles; the smallest is as much smaller as that in place."""
CHUNK = 50_000
ASCENT_STEPS = 16
"""Gradient ascent takes so many steps of one knot, then as many shrinking ones."""


@dataclass(frozen=True, slots=True)
class ForceBounds:
    """|ΔF| <= per_mm·|Δq| + per_cycle·|Δφ|, in N/mm and N a cycle."""

    per_mm: float
    per_cycle: float


@dataclass(frozen=True, slots=True)
class Continuity:
    """Force differences between neighbouring points against their bound.

    Attributes:
        blend, law: of the fixture.
        pairs: number of pairs with a force at both ends.
        largest_share: largest |ΔF| as a share of its bound.
        violations: pairs beyond the bound.
        across_switches, near_no_direction: pairs with a frame switch or the cycle's end between them, and
            pairs where |∇d| < 0.4.
        bounds: the bounds used.
    """

    blend: str
    law: str
    pairs: int
    largest_share: float
    violations: int
    across_switches: int
    near_no_direction: int
    bounds: ForceBounds


def force_bounds(evaluator: Evaluator) -> ForceBounds:
    """Bounds of the module's docstring from the fixture's coefficients."""
    c = evaluator.coefficients.astype(np.float64)
    knot = evaluator.model.knot_spacing_mm
    slope = math.hypot(*(_largest(np.diff(c, axis=a)) / knot for a in (1, 2, 3)))
    bend = math.hypot(
        *(_largest(np.diff(np.diff(c, axis=a), axis=b)) / knot**2 for a, b in product((1, 2, 3), repeat=2))
    )
    in_phase = _phase_slopes(evaluator, c)
    rate = _largest(in_phase)
    turn = math.hypot(*(_largest(np.diff(in_phase, axis=a)) / knot for a in (1, 2, 3)))
    cap = evaluator.law.cap_n
    stiffness = evaluator.law.stiffness_n_per_mm / cap
    if evaluator.blend == "force":
        width = _widths(evaluator.model.timing.fractions).min()
        per_cycle = min(stiffness * rate + DIRECTION_LIPSCHITZ * turn, 2.0 / width)
        return ForceBounds(cap * (stiffness * slope + DIRECTION_LIPSCHITZ * bend), cap * per_cycle)
    lever = FADE_OVER_NORM * _slope_times_distance(evaluator.law.parameters, stiffness) + DIRECTION_LIPSCHITZ
    return ForceBounds(
        cap * (stiffness + lever * bend), cap * (FADE_OVER_NORM * stiffness * rate + lever * turn)
    )


def check_continuity(evaluator: Evaluator, pairs: int, rng: np.random.Generator) -> Continuity:
    """Force at random pairs (q, φ) of neighbours, steps from 1e-7 of the largest to 0.3 mm and 0.02 cycles.

    A third of the pairs lies across a frame switch or the cycle's end, a third starts near the medial axis,
    the others anywhere in the box.

    Args:
        evaluator: the fixture.
        pairs: number of pairs drawn.
        rng: source of the pairs.
    """
    bounds = force_bounds(evaluator)
    worst, violations, used, across, uncertain = 0.0, 0, 0, 0, 0
    for begin in range(0, pairs, CHUNK):
        n = min(CHUNK, pairs - begin)
        q, phi = _positions(evaluator, n, rng)
        shrink = 10.0 ** rng.uniform(math.log10(SMALLEST_STEP_MM / LARGEST_STEP_MM), 0.0, n)
        dq = rng.normal(size=(n, 3))
        dq *= (LARGEST_STEP_MM * shrink / np.linalg.norm(dq, axis=1))[:, None]
        dphi = PHASE_STEP * shrink * rng.uniform(-1.0, 1.0, n)
        at_switch = np.arange(n) % 3 == 0
        switches = np.append(evaluator.model.timing.fractions, 0.0)
        phi = np.where(at_switch, rng.choice(switches, n) - dphi * rng.uniform(0.0, 1.0, n), phi)
        a, b = evaluator.force(q, phi), evaluator.force(q + dq, phi + dphi)
        ok = (a.status == Status.OK) & (b.status == Status.OK)
        # distances between the rounded ends, not the requested steps
        moved = np.linalg.norm((q + dq) - q, axis=1)
        turned = np.abs((phi + dphi) - phi)
        allowed = bounds.per_mm * moved + bounds.per_cycle * turned + 1e-12
        share = np.linalg.norm(b.force_n - a.force_n, axis=1)[ok] / allowed[ok]
        worst = max(worst, float(share.max(initial=0.0)))
        violations += int((share > 1.0).sum())
        used += int(ok.sum())
        across += int((ok & at_switch).sum())
        uncertain += int((np.linalg.norm(a.gradient[ok], axis=1) < 0.4).sum())
    law = type(evaluator.law).__name__.lower()
    return Continuity(evaluator.blend, law, used, worst, violations, across, uncertain, bounds)


def _positions(evaluator: Evaluator, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """(n, 3) positions in the box and (n,) phases; every third position is near the medial axis."""
    q, phi = rng.uniform(evaluator.model.origin_mm, evaluator.model.upper_mm, (n, 3)), rng.uniform(size=n)
    third = np.arange(1, n, 3)
    q[third] = _on_medial_axis(evaluator, q[third], phi[third], rng)
    return q, phi


def _on_medial_axis(
    evaluator: Evaluator, q: FloatArray, phi: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """(n, 3) positions near ridges of the distance: gradient ascent, then a shift by a sixth of a knot.

    On ridges normals meet and |∇d| is small. A position that would leave the box is not moved.
    """
    knot = evaluator.model.knot_spacing_mm
    for step in [knot] * ASCENT_STEPS + [knot * 0.75**k for k in range(ASCENT_STEPS)]:
        gradient = evaluator.force(q, phi).gradient
        norm = np.linalg.norm(gradient, axis=1, keepdims=True)
        # without a direction the position is not moved
        ahead = q + np.divide(step * gradient, norm, out=np.zeros_like(q), where=norm > 0.0)
        q = np.where(np.isfinite(ahead), ahead, q)
    return np.asarray(q + rng.normal(scale=knot / 6.0, size=q.shape))


def _phase_slopes(evaluator: Evaluator, c: FloatArray) -> FloatArray:
    """(n, cx, cy, cz) coefficients of ∂d/∂φ, or of fields of which it is a convex combination."""
    timing = evaluator.model.timing
    width = _widths(timing.fractions)
    if evaluator.blend == "periodic":
        # b_j − b_{j−1} over the three intervals j−2 … j+1, times the degree
        span = np.array([sum(width[(j + o) % len(width)] for o in (-2, -1, 0)) for j in range(len(width))])
        return np.asarray(3.0 * (c - np.roll(c, 1, axis=0)) / span[:, None, None, None])
    return np.asarray((np.roll(c, -1, axis=0) - c) / width[:, None, None, None])


def _widths(fractions: FloatArray) -> FloatArray:
    """(n,) time from each phase to the next, in cycles."""
    return np.diff(np.append(fractions, fractions[0] + 1.0))


def _slope_times_distance(parameters: FloatArray, stiffness: float) -> float:
    """T from the law's kernel parameters; with d/r for d where fields are blended."""
    kind, _, exponent, _, depth = parameters
    own = SIGMOID_SLOPE_TIMES_DISTANCE if int(kind) == SIGMOID else 2.0 * exponent / math.e
    return float(own + abs(depth) * stiffness)


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max())
