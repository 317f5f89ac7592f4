"""Path of the tool: free motion, then touching, sliding on and pressing into the beating heart."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray, Points, read_only_arrays

from .contact import BeatClock, MovingSurface
from .contact_sites import Site
from .hand import minimum_jerk, perpendicular, tremor

_KNOT_HZ = 50.0


@dataclass(frozen=True, slots=True)
class ToolSpec:
    """Parameters of the operator's task.

    Attributes:
        free_s: time for which the tool stays away at first (at most 0.3 of the recording).
        hover_mm: distance from the heart meanwhile.
        clear_mm: distance while moving from one site to the next.
        contact_s: time in contact at each site.
        depth_mm: mean intended depth; `press_mm` is the amplitude of pressing about it; less deep if the
            beat would carry the surface further than `max_depth_mm` over the tip.
        slip_mm: distance to which the hand follows the beating surface, as far as `follow_mm_s` lets it.
        follow_mm_s: largest speed at which the hand follows the beat.
        slide_mm: length of the slide over the surface.
        speed_mm_s: speed aimed at between sites.
        length_mm: tool origin to tip.
        sites: number of different sites, visited in turn.
        approach_s, retreat_s: time from clear distance to contact and back.
    """

    free_s: float = 12.0
    hover_mm: float = 30.0
    clear_mm: float = 17.0
    contact_s: float = 6.0
    depth_mm: float = 1.5
    press_mm: float = 0.6
    max_depth_mm: float = 2.8
    slip_mm: float = 0.8
    follow_mm_s: float = 20.0
    slide_mm: float = 10.0
    speed_mm_s: float = 18.0
    length_mm: float = 150.0
    sites: int = 6
    approach_s: float = 1.9
    retreat_s: float = 1.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipPath:
    """Motion of the tip in frame "mr": a spline through knots plus tremor; `t_s` (n,), `xyz_mm` (n, 3)."""

    t_s: FloatArray
    xyz_mm: FloatArray
    tremor_seed: int

    def __call__(self, t_s: FloatArray) -> FloatArray:
        smooth = CubicSpline(self.t_s, self.xyz_mm)(t_s)
        return np.asarray(smooth + tremor(np.random.default_rng(self.tremor_seed))(t_s))


def tip_path(
    surface: MovingSurface,
    clock: BeatClock,
    sites: list[Site],
    seconds: float,
    spec: ToolSpec,
    rng: np.random.Generator,
) -> TipPath:
    """Hover, then visit the sites one after the other until the recording ends."""
    free_s = min(spec.free_s, 0.3 * seconds)
    knots_s = np.arange(-10, int(seconds * _KNOT_HZ) + 60) / _KNOT_HZ
    xyz = np.empty((len(knots_s), 3))
    hover = sites[0].point_mm + spec.hover_mm * sites[0].normal
    wander = smooth_noise(3, 0.05, 0.25, rng)(knots_s) * 2.5
    fade = 1.0 - minimum_jerk((knots_s - free_s + 2.0) / 2.0)
    xyz[:] = hover + wander * fade[:, None]
    at_mm, begin_s, visit = hover, free_s, 0
    while begin_s < knots_s[-1]:
        site = sites[visit % len(sites)]
        entry = site.point_mm + spec.clear_mm * site.normal - 0.5 * spec.slide_mm * site.slide
        transit_s = max(1.0, 1.875 * float(np.linalg.norm(entry - at_mm)) / spec.speed_mm_s)
        touch_s = begin_s + transit_s
        end_s = touch_s + spec.approach_s + spec.contact_s + spec.retreat_s
        visited = (knots_s >= touch_s) & (knots_s < end_s)
        own_s = np.append(np.append(touch_s, knots_s[visited]), end_s)
        trail = _visit(surface, clock, site, own_s, touch_s, spec, rng)
        moving = (knots_s >= begin_s) & (knots_s < touch_s)
        share = minimum_jerk((knots_s[moving] - begin_s) / transit_s)[:, None]
        xyz[moving] = (1 - share) * at_mm + share * trail[0]
        xyz[visited] = trail[1:-1]
        at_mm, begin_s, visit = trail[-1], end_s, visit + 1
    return TipPath(knots_s, xyz, int(rng.integers(2**31)))


def _visit(
    surface: MovingSurface,
    clock: BeatClock,
    site: Site,
    t_s: FloatArray,
    touch_s: float,
    spec: ToolSpec,
    rng: np.random.Generator,
) -> FloatArray:
    """Compute (n, 3) tip positions: down to the surface, slide and press with the beat, and up.

    The hand moves along the site's normal. It carries the slow part of the surface's height and as much of
    the beat as keeps the slip within `slip_mm`; the rest makes the depth pulsate.
    """
    since = t_s - touch_s
    total = spec.approach_s + spec.contact_s + spec.retreat_s
    down = minimum_jerk(since / spec.approach_s)
    up = minimum_jerk((since - spec.approach_s - spec.contact_s) / spec.retreat_s)
    near = minimum_jerk((since / spec.approach_s - 0.4) / 0.6) * (
        1.0 - minimum_jerk((since - total + spec.retreat_s) / (0.6 * spec.retreat_s))
    )
    slide = (minimum_jerk((since - spec.approach_s) / spec.contact_s) - 0.5) * spec.slide_mm
    base = site.point_mm + slide[:, None] * site.slide
    height = _surface_height(surface, clock.model_phase(t_s), base, site.normal)
    slow = gaussian_filter1d(height, 0.45 * _KNOT_HZ, mode="nearest")
    beat = height - slow
    needed = float(np.clip(1.0 - spec.slip_mm / max(float(np.abs(beat).max()), 1e-6), 0.3, 0.95))
    fastest = float(np.abs(np.gradient(beat, t_s)).max())
    follow = min(needed, spec.follow_mm_s / max(fastest, 1e-6))
    carried = float(slow.mean())
    carried_height = carried + near * (slow - carried + follow * beat)
    deepest = (1.0 - follow) * float(beat.max()) + spec.press_mm
    mean_depth = min(spec.depth_mm, spec.max_depth_mm - deepest)
    press = spec.press_mm * np.sin(2 * np.pi * since / rng.uniform(2.2, 3.2) + rng.uniform(0, 2 * np.pi))
    depth = (mean_depth + spec.clear_mm + press * near) * down * (1.0 - up) - spec.clear_mm
    return np.asarray(base + (carried_height - depth)[:, None] * site.normal)


def _surface_height(
    surface: MovingSurface, phase: FloatArray, base_mm: FloatArray, normal: FloatArray
) -> FloatArray:
    """Find (n,) h at which base + h·normal meets the surface at each phase (Newton on the distance)."""
    height = np.zeros(len(base_mm))
    for _ in range(6):
        distance, gradient = surface.distance(base_mm + height[:, None] * normal, phase)
        height -= distance / np.minimum(gradient @ normal, -0.4)
    return height


def tool_path(tip: TipPath, access: FloatArray, tip_in_tool: Points, rng: np.random.Generator) -> PosePath:
    """Build mr_from_tool of a tool whose tip follows `tip` while its handle stays about direction `access`.

    Args:
        access: (3,) unit direction from the heart towards the operator's hand.
        tip_in_tool: one point in frame "tool".
    """
    offset = tip_in_tool.xyz_mm[0]
    to_tip = offset / np.linalg.norm(offset)
    side_tool = perpendicular(to_tip, np.array([1.0, 0.0, 0.0]))
    axes_tool = np.stack([to_tip, side_tool, np.cross(to_tip, side_tool)])
    side = perpendicular(access, np.array([0.0, 0.0, 1.0]))
    other = np.cross(access, side)
    sway = smooth_noise(3, 0.03, 0.15, rng)

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        lean = 0.1 * sway(t_s)
        handle = access + lean[:, :1] * side + lean[:, 1:2] * other
        handle /= np.linalg.norm(handle, axis=1)[:, None]
        across = side - handle * (handle @ side)[:, None]
        across /= np.linalg.norm(across, axis=1)[:, None]
        frame = np.stack([-handle, across, np.cross(-handle, across)], axis=1)
        roll = Rotation.from_rotvec(-handle * lean[:, 2:]).as_matrix()
        rotations = roll @ np.swapaxes(frame, 1, 2) @ axes_tool
        return rotations, tip(t_s) - rotations @ offset

    return path
