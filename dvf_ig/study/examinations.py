"""Compare surfaces, descent of the base and slice shifts of models built from examinations with their truth.

Hearts of the first world are imaged as short-axis stacks, with and without long-axis cines, and isotropically
with labels of every phase. Distances are of both directions between the model's epicardium and the true one
at end-diastole and end-systole: of all of it, and of the part that slices show (the same part for all kinds
of a heart). The unit is the heart.

    dvf-ig study examinations --seeds 6 --seed 1001 -o study
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from data_synth import HeartSpec, MotionPreset, PhantomAnatomy, ScenarioSpec, cine_preop, two_segment_phase
from data_synth.mr.cine import MrProtocol
from data_synth.mr.examination import Examination, ExamName, examination
from data_synth.scenario.recording import scenario_heart
from data_synth.seeds import child_rng
from dvf_ig.core import CycleTiming, FloatArray, Mesh, Preop, SeenPart, Volume, VolumeSeries, nearest_phase
from dvf_ig.core.model import DvfModel
from dvf_ig.preop import CineModel, CineOptions, MotionOptions, check_surface, model_from_cine
from dvf_ig.preop.build import ModelOptions, model_from_labels
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials, refusals
from dvf_ig.study.hearts.recordings import EXAM_PHASES
from dvf_ig.study.options import seed_option, seeds_option

KNOT_MM = 8.0
"""Knots of the splines, which are fitted to the surfaces that are compared here."""
POINTS = 3000
LV_BLOOD = 2
IMAGED: tuple[ExamName, ...] = ("sax10", "sax+lax")
"""What is imaged; the stack of the second without its views is sax8."""
EXAMS = ("sax10", "sax8", "sax+lax")
ISOTROPIC, ISOTROPIC_PHASES = "isotropic", 8
NUMBERS = ("ed_whole_mm", "ed_seen_mm", "es_whole_mm", "es_seen_mm")


@dataclass(frozen=True, kw_only=True)
class ExaminationsSettings:
    """Options of the study."""

    seeds: int = seeds_option(6)
    seed: int = seed_option(1001)


def trial(_: Settings, seed: int) -> Line:
    """Build and compare the models of one heart."""
    motion: MotionPreset = "physiological" if seed % 2 else "paper5mm"
    spec = ScenarioSpec(seed=seed, heart=HeartSpec("varied"), motion=motion, mismatch_mm=0.0)
    anatomy = scenario_heart(spec)
    line: Line = {}
    seen: SeenPart | None = None
    for name in IMAGED:
        rng = child_rng(spec.seeds.anatomy, "preop")
        exam = examination(anatomy, anatomy.reference, name, rng, EXAM_PHASES)
        built = _built(exam)
        line[name] = _scores(anatomy, exam, built)
        seen = built.model.seen
        if exam.lax:
            stack = replace(exam, lax=())
            line["sax8"] = _scores(anatomy, stack, _built(stack))
    protocol = MrProtocol(phases=ISOTROPIC_PHASES)
    isotropic = cine_preop(anatomy, child_rng(spec.seeds.anatomy, "preop"), protocol)
    line[ISOTROPIC] = _isotropic(anatomy, isotropic, seen)
    return line


def _built(exam: Examination) -> CineModel:
    preop, labels = exam.preop("phantom"), exam.sax.labels.values[0]
    options = CineOptions(
        organ_labels=preop.organ_labels,
        cavity_labels=preop.blood_labels,
        motion=MotionOptions(threads=1),
        model=ModelOptions(KNOT_MM, threads=1),
    )
    image = exam.sax.image
    return model_from_cine(
        image, Volume(image.grid, labels), patient_id="phantom", views=exam.views, options=options
    )


def _scores(anatomy: PhantomAnatomy, exam: Examination, built: CineModel) -> dict[str, Any]:
    """Distances, descent, shifts and end-systoles of one model.

    The mean of all breath-holds is no slice's shift, and is added to the truth.
    """
    shift_mm = np.concatenate([exam.sax.slice_shift_mm, *(view.slice_shift_mm for view in exam.lax)]).mean(
        axis=0
    )
    model, base = built.model, built.base
    es_phase = _es_phase(anatomy, model.timing)
    scores = _distances(anatomy, model, es_phase, shift_mm)
    if model.seen is None or base is None or built.phases is None:
        raise TypeError("a stack has a seen part, a descent and phases")
    # the point of the long axis in the basal slice's plane
    axis, height = anatomy.long_axis_mm, base.ends_mm[1]
    low, high = (axis + shift_mm) @ model.seen.normal
    point = axis[:1] + (height - low) / (high - low) * (axis[1:] - axis[:1])
    true = anatomy.deformed(point, float(model.timing.fractions[es_phase])) - point
    scores["descent_mm"] = float(base.base_mm[es_phase])
    scores["true_descent_mm"] = -float((true @ model.seen.normal)[0])
    labelled = exam.sax.labels.values[0].any(axis=(0, 1))
    blood = (exam.sax.labels.values[0] == LV_BLOOD).any(axis=(0, 1))
    moments = np.linspace(0.0, 1.0, 2001)
    at = two_segment_phase(moments, exam.sax.slice_rr_s[:, None], anatomy.rr_s, anatomy.es_fraction)
    true_es = np.array([np.interp(anatomy.es_fraction, row, moments) for row in at])
    scores["es_sd"] = float((built.phases.es - true_es)[blood].std())
    scores["es_sd_by_index"] = float(true_es[blood].std())
    if built.shifts is not None:
        true_mm = (exam.sax.slice_shift_mm - shift_mm) @ exam.sax.image.grid.direction
        left = built.shifts.sax_mm @ exam.sax.image.grid.direction - true_mm
        scores["shift_left_mm"] = np.linalg.norm(left[labelled, :2], axis=1).tolist()
        scores["shift_before_mm"] = np.linalg.norm(true_mm[labelled, :2], axis=1).tolist()
        scores["shift_through_left_mm"] = np.abs(left[labelled, 2]).tolist()
        scores["shift_z"] = (left / built.shifts.sax_sigma_mm)[labelled].tolist()
    return scores


def _isotropic(anatomy: PhantomAnatomy, preop: Preop, seen: SeenPart | None) -> dict[str, Any]:
    """Distances of the model of labels of end-diastole and end-systole, on the grid of isotropic MR."""
    labels = preop.labels
    if labels is None or seen is None:
        raise TypeError("isotropic MR has labels, and a stack a seen part")
    es_phase = _es_phase(anatomy, labels.timing)
    both = CycleTiming(labels.timing.fractions[[0, es_phase]], labels.timing.rr_s)
    two = replace(preop, mr=None, labels=VolumeSeries(labels.grid, labels.values[[0, es_phase]], both))
    model = model_from_labels(two, options=ModelOptions(KNOT_MM))
    slabs = seen.bounds_mm[[0, min(es_phase, len(seen.bounds_mm) - 1)]]
    part = SeenPart(seen.normal, slabs, seen.ends_mm, np.zeros(2))
    return _distances(anatomy, replace(model, seen=part), 1, np.zeros(3))


def _es_phase(anatomy: PhantomAnatomy, timing: CycleTiming) -> int:
    return int(nearest_phase(timing.fractions, np.array([anatomy.es_fraction]))[0])


def _distances(anatomy: PhantomAnatomy, model: DvfModel, es_phase: int, held: FloatArray) -> dict[str, Any]:
    scores: dict[str, Any] = {}
    for name, phase in (("ed", 0), ("es", es_phase)):
        vertices = anatomy.surface_vertices(float(model.timing.fractions[phase])) + held
        truth = Mesh(model.frame, vertices, anatomy.surface_triangles)
        check = check_surface(model, phase, truth, points=POINTS, rng=np.random.default_rng(0))
        scores[f"{name}_whole_mm"] = float(check.whole_mm.mean())
        scores[f"{name}_seen_mm"] = float(check.seen_mm.mean())
    return scores


def run(settings: ExaminationsSettings, driver: Driver) -> Result:
    """Compare all hearts."""
    seeds = range(settings.seed, settings.seed + settings.seeds)
    lines = driver.trials(Trials("examinations", {}, trial), seeds)
    good = [line for line in lines if "refused" not in line]
    summary = {"hearts": len(good), "seed": settings.seed, "trials": lines}
    return Result(summary, _table(good), {"summary.json": summary}, refusals(lines))


def _table(lines: Sequence[Line]) -> Rows:
    rows: Rows = [
        ("", "ED whole mm", "ED seen", "ES whole", "ES seen", "descent off", "shift left", "ES of slices")
    ]
    if not lines:
        return rows
    for kind in (*EXAMS, ISOTROPIC):
        each = [line[kind] for line in lines]
        cells = [f"{np.mean([one[name] for one in each]):.2f}" for name in NUMBERS]
        off = [abs(one["descent_mm"] - one["true_descent_mm"]) for one in each if "descent_mm" in one]
        cells.append(f"{np.mean(off):.1f}, at most {max(off):.1f} mm" if off else "-")
        left, before = (
            np.concatenate([one.get(name, []) for one in each])
            for name in ("shift_left_mm", "shift_before_mm")
        )
        cells.append(f"{left.mean():.2f} of {before.mean():.2f} mm in plane" if len(left) else "-")
        sd = [(one["es_sd"], one["es_sd_by_index"]) for one in each if "es_sd" in one]
        cells.append("± {:.3f} RR (by index {:.3f})".format(*np.mean(sd, axis=0)) if sd else "-")
        rows.append((kind, *cells))
    return rows


STUDY = Study(ExaminationsSettings, run)
