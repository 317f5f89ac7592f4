"""A lesion of the left atrium: a line of the beating wall is guided, the oesophagus behind it forbidden.

Ren 2008 names the ablation of atrial fibrillation; sizes, gap and margin here are assumed. The heart's outer
surface represents the atrium's wall, which the phantom's surface does not tell apart. One definition serves
the operators' task and the scenario of `synth scenario --preset atrial`.
"""

from dataclasses import dataclass

import numpy as np
from skimage.measure import marching_cubes

from data_synth.operator.contact_sites import Site, contact_sites
from data_synth.operator.hand import minimum_jerk
from data_synth.operator.simulated_operator import RATE_HZ
from data_synth.seeds import child_rng
from dvf_ig.core import (
    DvfModel,
    FloatArray,
    InvalidInputError,
    Mesh,
    SurfaceSeries,
    ToolTruth,
    read_only_arrays,
)
from dvf_ig.guidance import (
    DEVICES,
    Evaluator,
    FixtureOptions,
    FixtureSet,
    Gaussian,
    PathTarget,
    Sigmoid,
)
from dvf_ig.guidance.devices.simulated import FASTEST_MM_S
from dvf_ig.guidance.laws import gaussian_steepness
from dvf_ig.preop import model_from_surfaces, model_of_still
from dvf_ig.study.operators.closed_loop import (
    ACCESS,
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

LESION_MM = 30.0
SPEED_MM_S = 4.0
SLOWING_MM = 2.0
"""The operator moves at half speed where tip and aim are so far apart by what is seen and felt."""
ABOVE_MM = 8.0
"""The tip starts so far above the surface."""
APPROACH_S = 3.0
SETTLE_S = 1.0
"""Between the end of the approach and the beginning of the line."""
LONGEST_S = 60.0
APPROACH, DRAW = 0.0, 1.0
"""Stages."""
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


class LineTask:
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
        speed = SPEED_MM_S / (1.0 + (believed_error_mm / SLOWING_MM) ** 2)
        planned = speed * line.tangent(self._along)
        self._along += speed / RATE_HZ
        return Aim(place, planned, beat, DRAW)


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
    tube, model = tube_behind(line.places_mm, site), heart.model
    above = ABOVE_MM * site.normal
    drawn = line.points(float(model.timing.fractions[model.ed_phase]))
    fixtures = lesion_fixtures(model, drawn, tube.model(model.patient_id))
    start, pull = line.at(0.0, 0.0) + above, fixtures[0].law
    loop = Loop(heart, condition, seed, pull, start, -site.normal, 0.0, fixtures=fixtures)
    trace = run_task(loop, LineTask(line, above, loop), LONGEST_S)
    phases = [heart.phase(condition, t) for t in trace.t_s.tolist()]
    off = [distance_to_line(tip, line.points(at)) for tip, at in zip(trace.tip_mm, phases, strict=True)]
    return Lesion(trace, np.array(off), tube.distance_mm(trace.tip_mm))


def tube_behind(places_mm: FloatArray, site: Site) -> Tube:
    """Along a line over a site, GAP_MM behind the deepest of its places (…, 3) over the beat."""
    deepest = float(((places_mm - site.point_mm) @ site.normal).min())
    middle = site.point_mm + (deepest - GAP_MM - TUBE_MM) * site.normal
    half = (0.5 * LESION_MM + BEYOND_MM) * site.slide
    return Tube(middle - half, middle + half)


def lesion_fixtures(
    model: DvfModel, drawn_mm: FloatArray, oesophagus: DvfModel
) -> tuple[FixtureOptions, FixtureOptions]:
    """Guide to the line (n, 3), drawn at end-diastole and beating with the model; forbid the oesophagus."""
    path, (pull, wall) = PathTarget.beating(model, drawn_mm), lesion_laws()
    return (
        FixtureOptions(pull, path=path, name="lesion", structure=model),
        FixtureOptions(wall, name="oesophagus", structure=oesophagus),
    )


def lesion_laws() -> tuple[Gaussian, Sigmoid]:
    """The steepest guidance and forbidden region that every simulated device renders.

    The guidance has the paper's force; the forbidden region the largest that every device holds, because a
    hand that believes the tip short of the line pushes on until the force is spent.
    """
    cap_n = Sigmoid().cap_n
    limits = [device.limits(fastest_mm_s=FASTEST_MM_S) for device in DEVICES.values()]
    stiffest = (1.0 - 1e-9) * min(one.allowed_stiffness_n_per_mm for one in limits)
    largest_n = min(one.continuous_force_n for one in limits)
    pull = Gaussian(gaussian_steepness(0.5) * cap_n / stiffest, 0.5, cap_n)
    return pull, Sigmoid(4.0 * stiffest / largest_n, largest_n, -MARGIN_MM)


def lesion_measures(lesion: Lesion) -> dict[str, float]:
    """Distances to the line while drawing, and the least to the oesophagus at any time."""
    drawing = lesion.trace.stage == DRAW
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


DRAWN_MM = 2.0
"""Between two points of a line that is drawn for a scenario."""
NEWTON_STEPS = 8


def scenario_fixtures(tool: ToolTruth, surface: SurfaceSeries) -> FixtureSet:
    """The lesion's fixtures where a scenario's tool touches the heart.

    Args:
        tool: true contact of the tool, which slides along one line.
        surface: of the heart at the time of the MR, with vertices that correspond from phase to phase.
    Raises:
        InvalidInputError: the tool never touches the heart.
    """
    if not (tool.distance_mm > 0.0).any():
        raise InvalidInputError("the tool does not touch the heart; make the scenario longer: --seconds 60")
    model = model_from_surfaces(surface)
    touched = tool.tip_mr_mm[tool.distance_mm > 0.0]
    middle = touched.mean(axis=0)
    along = np.linalg.svd(touched - middle, full_matrices=False)[2][0]
    count = 1 + round(LESION_MM / DRAWN_MM)
    spread = (np.arange(count) - 0.5 * (count - 1)) * DRAWN_MM
    drawn, normal = _on_surface(model, middle + spread[:, None] * along)
    site = Site(drawn[count // 2], normal, along)
    places = PathTarget.beating(model, drawn).points_mm
    return FixtureSet(lesion_fixtures(model, drawn, tube_behind(places, site).model(model.patient_id)))


def _on_surface(model: DvfModel, xyz_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points moved to the surface at end-diastole, and the mean outward unit normal (3,) there."""
    evaluator, phase = Evaluator(model, Sigmoid()), float(model.timing.fractions[model.ed_phase])
    gradient = np.zeros_like(xyz_mm)
    for _ in range(NEWTON_STEPS):
        samples = evaluator.force(xyz_mm, phase)
        gradient = samples.gradient
        xyz_mm = xyz_mm - (samples.distance_mm / (gradient**2).sum(axis=1))[:, None] * gradient
    normal = -gradient.mean(axis=0)
    return xyz_mm, normal / np.linalg.norm(normal)
