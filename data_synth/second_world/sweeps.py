"""Positions and sweeps of the second world's probes: turned, rocked, slid or moved by hand.

Frame "plane": x lateral, y depth, z elevation, origin at the apex of the fan.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.heart.reference import ReferenceMap
from data_synth.heart.tissue import Tissue
from data_synth.operator.hand import perpendicular, tremor
from data_synth.seeds import child_rng
from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray

from .drawn import Drawn
from .probes import probe_kind
from .resting_heart import RestingHeart

WAYS: dict[str, dict[str, float]] = {
    "epicardial": {"turned": 0.3, "rocked": 0.25, "slid": 0.25, "free": 0.2},
    "narrow": {"turned": 0.25, "rocked": 0.35, "slid": 0.25, "free": 0.15},
    "tee": {"turned": 0.6, "rocked": 0.2, "free": 0.2},
    "ice": {"turned": 0.3, "rocked": 0.7},
}
"""Manners of sweeping each probe, with their probabilities."""

_WINDOWS = np.array([[0.5, -0.85, -0.2], [0.1, -0.98, 0.15], [0.75, -0.45, -0.5]])
"""Directions from the heart's centre (LPS) of an open chest: from the left front, the front, the apex."""
_CONE_DEG = 22.0


def sweep_way(drawn: Drawn) -> str:
    """Draw the manner of the sweep."""
    return drawn.choice("sweep", WAYS[probe_kind(drawn)])


def sweep(heart: RestingHeart, reference: ReferenceMap, drawn: Drawn) -> tuple[PosePath, FloatArray]:
    """Draw mr_from_plane over time, and (3,) the direction from the heart's centre to the probe."""
    eye, aim = probe_place(probe_kind(drawn), heart, reference, drawn)
    return _swept(eye, aim, sweep_way(drawn), drawn), (eye - aim) / np.linalg.norm(eye - aim)


def probe_place(
    kind: str, heart: RestingHeart, reference: ReferenceMap, drawn: Drawn
) -> tuple[FloatArray, FloatArray]:
    """Place the fan's apex of a kind of probe and the point it looks at: (3,) each, frame "mr"."""
    rng = child_rng(drawn.seed, "second world window")
    middle = heart.ed_vertices_mm.mean(axis=0)
    miss = rng.standard_normal(3)
    aim = middle + drawn["sweep.aim_mm"] * miss / np.linalg.norm(miss)
    standoff = drawn[f"{kind}.standoff_mm"]
    if kind in ("ice", "tee"):
        # from behind or within, the probe looks at the ventricles
        ventricles = 0.5 * (_chamber(reference, Tissue.LV_BLOOD) + _chamber(reference, Tissue.RV_BLOOD))
        aim = aim + 0.5 * (ventricles - middle)
    if kind == "ice":
        return _chamber(reference, Tissue.RA_BLOOD), aim
    if kind == "tee":
        atrium = _chamber(reference, Tissue.LA_BLOOD)
        behind = _unit(np.array([0.0, 1.0, 0.0]) + 0.25 * rng.standard_normal(3))
        return _outside(reference, atrium, behind, standoff), aim
    best, score = None, np.inf
    for _ in range(24):
        direction = _unit(
            _unit(_WINDOWS[rng.integers(len(_WINDOWS))])
            + np.tan(np.deg2rad(_CONE_DEG)) * 0.6 * rng.standard_normal(3)
        )
        eye = _outside(reference, middle, direction, standoff)
        shut = _blocked(reference, eye, middle) + 0.02 * float(rng.uniform())
        if shut < score:
            best, score = eye, shut
    return np.asarray(best), aim


def _swept(eye: FloatArray, aim: FloatArray, way: str, drawn: Drawn) -> PosePath:
    rng = child_rng(drawn.seed, "second world sweep")
    beam = _unit(aim - eye)
    lateral = perpendicular(beam, rng.standard_normal(3))
    base = np.column_stack([lateral, beam, np.cross(lateral, beam)])
    period, start = drawn["sweep.period_s"], rng.uniform(0, 2 * np.pi)
    turn, rock = np.deg2rad(drawn["sweep.turn_deg"]), np.deg2rad(drawn["sweep.rock_deg"])
    slide, wander_mm = drawn["sweep.slide_mm"], drawn["sweep.wander_mm"]
    wander = np.deg2rad(drawn["sweep.wander_deg"])
    slow, shake = smooth_noise(6, 0.03, 0.12, rng), tremor(rng)
    reach = {"turned": (1.0, 0.25, 0.1), "rocked": (0.45, 1.0, 0.15), "slid": (0.5, 0.3, 1.0)}
    turned, rocked, slid = reach.get(way, (0.0, 0.0, 0.0))

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(t_s, dtype=np.float64)
        main, other = 2 * np.pi * t / period + start, 2 * np.pi * t / (2.7 * period) + 2 * start
        hand = slow(t)
        fast, even = np.sin(main), np.sin(other)
        # the movement that names the sweep is the fast one
        roll = turned * turn * (fast if way == "turned" else even)
        tilt = rocked * rock * (fast if way == "rocked" else even)
        along = slid * slide * (fast if way == "slid" else even)
        if way == "free":
            roll, tilt, along = 0.8 * turn * hand[:, 3], 0.7 * rock * hand[:, 4], 0.6 * slide * hand[:, 5]
        angles = np.column_stack([roll, tilt + wander * hand[:, 0], wander * hand[:, 1]])
        local = Rotation.from_euler("YXZ", angles).as_matrix()
        shift = along[:, None] * base[:, 2] + wander_mm * (
            hand[:, 2, None] * base[:, 0] + 0.5 * hand[:, 1, None] * base[:, 2]
        )
        return base @ local, eye + shift + shake(t)

    return path


def _chamber(reference: ReferenceMap, chamber: Tissue) -> FloatArray:
    """Find the (3,) middle of a chamber."""
    nodes = np.argwhere((reference.inner == chamber) & (reference.organ_mm > 0))
    return np.asarray(reference.origin_mm + reference.spacing_mm * nodes.mean(axis=0))


def _looked_up(reference: ReferenceMap, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Look up depth below the epicardium (−100 outside the map), and code of the surroundings."""
    index = np.rint((points - reference.origin_mm) / reference.spacing_mm).astype(int)
    shape = np.array(reference.organ_mm.shape)
    inside = ((index >= 0) & (index < shape)).all(axis=1)
    at = tuple(np.clip(index, 0, shape - 1).T)
    depth = np.where(inside, reference.organ_mm[at], -100.0)
    return depth, np.where(inside, reference.outer[at], int(Tissue.MEDIASTINUM))


def _outside(
    reference: ReferenceMap, start: FloatArray, direction: FloatArray, standoff_mm: float
) -> FloatArray:
    """Find the last point of the heart along a ray, and go a standoff further."""
    steps = np.arange(0.0, 180.0, 0.5)
    depth, _ = _looked_up(reference, start + steps[:, None] * direction)
    last = steps[np.flatnonzero(depth > 0)[-1]] if (depth > 0).any() else 0.0
    return np.asarray(start + (last + standoff_mm) * direction)


def _blocked(reference: ReferenceMap, eye: FloatArray, aim: FloatArray) -> float:
    """Compute the share of a cone of rays from the eye towards the heart that lung or bone stop."""
    beam = _unit(aim - eye)
    side = perpendicular(beam, np.array([0.0, 0.0, 1.0]))
    up = np.cross(beam, side)
    spread = np.tan(np.deg2rad(25.0))
    tips = [(0.0, 0.0)] + [(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4]
    steps = np.arange(0.0, float(np.linalg.norm(aim - eye)), 2.0)[:, None]
    shut = []
    for across, high in tips:
        ray = _unit(beam + spread * (across * side + high * up))
        depth, outer = _looked_up(reference, eye + steps * ray)
        shut.append(bool(((depth <= 0) & np.isin(outer, (Tissue.LUNG, Tissue.BONE))).any()))
    return float(np.mean(shut))


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))
