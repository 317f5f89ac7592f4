"""Tasks without pellets: a lesion along a line, manual tracking.

Tracking is of a place of the beating surface over 30 cycles (Figs 14, 15); a lesion is along a line that
beats, before an oesophagus that does not. Automatic tracking, a stylus in nobody's hand, is
`dvf_ig.study.tracking`.
"""

from dataclasses import dataclass, replace

import numpy as np
from skimage.measure import marching_cubes

from data_synth.operator.contact_sites import Site, contact_sites
from data_synth.operator.hand import minimum_jerk, perpendicular
from data_synth.operator.simulated_operator import RATE_HZ
from data_synth.seeds import child_rng
from dvf_ig.core import DvfModel, FloatArray, Mesh, read_only_arrays
from dvf_ig.guidance import FixtureOptions, Gaussian, PathTarget
from dvf_ig.preop import model_of_still
from dvf_ig.study.operators.closed_loop import (
    ACCESS,
    DEVICE,
    Aim,
    Condition,
    Loop,
    MovingLine,
    OperatingHeart,
    Trace,
    moving_line,
    operator_of,
    run_task,
)
from dvf_ig.study.operators.pellets import cutting_law, guidance_law
from dvf_ig.study.tracking.stylus import BeatingSurface, hold_stylus, with_fixture

CUT_SPEED_MM_S = 4.0
SLOWING_MM = 2.0
"""The operator moves at half speed where tip and aim are so far apart by what is seen and felt."""
ABOVE_MM = 8.0
"""The tip starts so far above the surface."""
APPROACH_S = 3.0
SETTLE_S = 1.0
"""Between the end of the approach and the beginning of the cut."""
LONGEST_CUT_S = 60.0
APPROACH, CUT = 0.0, 1.0
"""Stages."""


class CuttingTask:
    """Aims along a line: down to it, then along it, slower where tip and aim lie apart."""

    def __init__(self, line: MovingLine, above_mm: FloatArray, loop: Loop) -> None:
        self._line, self._above, self._loop = line, above_mm, loop
        self._timing_s = operator_of(loop).timing_error_s
        self._along = 0.0

    def __call__(self, t_s: float, tip_mm: FloatArray, believed_error_mm: float) -> Aim:
        heart, condition, line = self._loop.heart, self._loop.condition, self._line
        phase = heart.phase(condition, t_s)
        place = line.at(self._along, phase)
        foreseen = heart.phase(condition, t_s + self._timing_s)
        beat = line.rate_mm(self._along, foreseen) / heart.cycle(condition)
        if t_s < APPROACH_S + SETTLE_S:
            down = (minimum_jerk(np.array([t_s, t_s + 1.0 / RATE_HZ]) / APPROACH_S) - 1.0).tolist()
            planned = -(down[1] - down[0]) * RATE_HZ * self._above
            return Aim(place - down[0] * self._above, planned, beat, APPROACH)
        if self._along >= line.length_mm:
            return Aim(place, np.zeros(3), beat, -1.0)
        speed = CUT_SPEED_MM_S / (1.0 + (believed_error_mm / SLOWING_MM) ** 2)
        planned = speed * line.tangent(self._along)
        self._along += speed / RATE_HZ
        return Aim(place, planned, beat, CUT)


LESION_MM = 30.0
GAP_MM = 4.0
"""Least distance of the line from the oesophagus' surface over the beat: wall and fat, assumed."""
TUBE_MM, BEYOND_MM = 8.0, 25.0
"""Radius of the oesophagus, and its length beyond either end of the line: assumed."""
MARGIN_MM = 2.0
"""Half of the forbidden region's force is felt this far before the oesophagus."""
WITHIN_MM = 2.0
"""A tip this close to the line makes the lesion there."""
FIELD_MM = 2.0
"""Pitch of the image from which the oesophagus' mesh is made."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """An oesophagus: all within TUBE_MM of the straight line from `start_mm` to `end_mm`, (3,)."""

    start_mm: FloatArray
    end_mm: FloatArray

    def distance_mm(self, xyz_mm: FloatArray) -> FloatArray:
        """(…,) distance of (…, 3) points to its surface, negative inside."""
        return distance_to_line(xyz_mm, np.stack([self.start_mm, self.end_mm])) - TUBE_MM

    def model(self, patient_id: str) -> DvfModel:
        """The fixture's model of it, in the frame "mr"."""
        ends = np.stack([self.start_mm, self.end_mm])
        low = ends.min(axis=0) - TUBE_MM - 2.0 * FIELD_MM
        shape = np.ceil((ends.max(axis=0) + TUBE_MM + 2.0 * FIELD_MM - low) / FIELD_MM).astype(int) + 1
        places = np.moveaxis(np.indices(tuple(shape)), 0, -1) * FIELD_MM + low
        vertices, triangles, *_ = marching_cubes(self.distance_mm(places), 0.0, spacing=(FIELD_MM,) * 3)
        mesh = Mesh("mr", vertices + low, triangles)
        return model_of_still(mesh, patient_id=patient_id, surface_name="oesophagus")


def distance_to_line(xyz_mm: FloatArray, line_mm: FloatArray) -> FloatArray:
    """(…,) distance of (…, 3) points to the straight segments between (n, 3) points."""
    along = np.diff(line_mm, axis=0)
    off = xyz_mm[..., None, :] - line_mm[:-1]
    share = np.clip((off * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * along, axis=-1).min(axis=-1))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Lesion:
    """One operator's lesion.

    Attributes:
        trace: of it.
        line_mm: (n,) distance of the tip to the line, which beats; tube_mm: to the oesophagus.
    """

    trace: Trace
    line_mm: FloatArray
    tube_mm: FloatArray


def ablate(heart: OperatingHeart, condition: Condition, seed: int) -> Lesion:
    """One operator's lesion along a line of the beating wall, the oesophagus behind it forbidden."""
    site = contact_sites(heart.truth, ACCESS, 1, child_rng(seed, "lesion"))[0]
    line = moving_line(heart.truth, site, LESION_MM, 0.0)
    tube = tube_behind(line, site)
    above = ABOVE_MM * site.normal
    fixtures = lesion_fixtures(heart.model, line, tube)
    start, wall = line.at(0.0, 0.0) + above, fixtures[1].law
    loop = Loop(heart, condition, seed, wall, start, -site.normal, 0.0, fixtures=fixtures)
    trace = run_task(loop, CuttingTask(line, above, loop), LONGEST_CUT_S)
    phases = [heart.phase(condition, t) for t in trace.t_s.tolist()]
    off = [distance_to_line(tip, line.points(at)) for tip, at in zip(trace.tip_mm, phases, strict=True)]
    return Lesion(trace, np.array(off), tube.distance_mm(trace.tip_mm))


def tube_behind(line: MovingLine, site: Site) -> Tube:
    """Along the line, and GAP_MM behind its deepest place of the beat."""
    places = line.places_mm.reshape(-1, 3)
    deepest = float(((places - site.point_mm) @ site.normal).min())
    middle = site.point_mm + (deepest - GAP_MM - TUBE_MM) * site.normal
    half = (0.5 * LESION_MM + BEYOND_MM) * site.slide
    return Tube(middle - half, middle + half)


def lesion_fixtures(model: DvfModel, line: MovingLine, tube: Tube) -> tuple[FixtureOptions, ...]:
    """Guide to the line, drawn at end-diastole and beating with the model; forbid the oesophagus."""
    drawn = line.points(float(model.timing.fractions[model.ed_phase]))
    oesophagus = tube.model(model.patient_id)
    return (
        FixtureOptions(tracking_law(), path=PathTarget.beating(model, drawn), name="line", structure=model),
        FixtureOptions(replace(cutting_law(), depth_mm=-MARGIN_MM), name="oesophagus", structure=oesophagus),
    )


def lesion_measures(lesion: Lesion) -> dict[str, float]:
    """Distances to the line while drawing, and the least to the oesophagus at any time."""
    drawing = lesion.trace.stage == CUT
    off = lesion.line_mm[drawing]
    return {
        "line_mm": float(off.mean()),
        "within_share": float((off <= WITHIN_MM).mean()),
        "tube_mm": float(lesion.tube_mm.min()),
        "within_margin_s": float((lesion.tube_mm < MARGIN_MM).sum() / RATE_HZ),
        "time_s": float(drawing.sum() / RATE_HZ),
        "largest_force_n": float(lesion.trace.force_n.max()),
        "withheld_s": lesion.trace.withheld_s,
    }


CYCLES = 30
TRACK = 0.0
"""Stage."""


def tracking_law() -> Gaussian:
    """The guidance of the automatic kind: of smallest dead band among what the device renders."""
    return guidance_law(0.0)


def automatic(surface: BeatingSurface) -> dict[str, float]:
    """The stylus in nobody's hand, on the same device under the same law, at all places."""
    return hold_stylus(surface, with_fixture(DEVICE, "force", compensate=False), cycles=CYCLES).summary()


def track(heart: OperatingHeart, place: Site, condition: Condition, seed: int) -> Trace:
    """One operator follows one place of the surface."""
    point = moving_line(heart.truth, place, 0.0, 0.0)
    cycle_s = heart.cycle(condition)
    loop = Loop(heart, condition, seed, tracking_law(), point.at(0.0, 0.0), -place.normal, 0.0)
    timing_s = operator_of(loop).timing_error_s

    def task(t_s: float, tip_mm: FloatArray, believed_error_mm: float) -> Aim:
        beat = point.rate_mm(0.0, heart.phase(condition, t_s + timing_s)) / cycle_s
        return Aim(point.at(0.0, heart.phase(condition, t_s)), np.zeros(3), beat, TRACK)

    return run_task(loop, task, CYCLES * cycle_s)


def tracked_place(heart: OperatingHeart, surface: BeatingSurface, seed: int) -> Site:
    """One of the places of the automatic kind, drawn by the operator's seed, and its normal."""
    start = surface.starts_mm[child_rng(seed, "place").integers(len(surface.starts_mm))]
    normal = -heart.truth.distance(start[None], np.zeros(1))[1][0]
    return Site(start, normal, perpendicular(normal, np.array([0.0, 0.0, 1.0])))


def tracking_measures(trace: Trace) -> dict[str, float]:
    """Measures of |distance to the true surface| over all cycles."""
    error = np.abs(trace.depth_mm)
    return {
        "mean_mm": float(error.mean()),
        "rms_mm": float(np.sqrt((error**2).mean())),
        "p95_mm": float(np.percentile(error, 95)),
        "max_mm": float(error.max()),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }
