"""Let simulated operators do the tasks of Ren 2008 with and without the fixture's force.

No person takes part. The unit is the simulated operator; the same operators work under every condition.
Means have bootstrap intervals over operators (95 %); a difference is that of the same operator under two
conditions, with its effect size d_z, the mean difference over the standard deviation of the differences
(Cohen 1988), whose interval is the large-sample one (Hedges and Olkin 1985).

    dvf-ig study operators --task cutting --seeds 20 -o study
"""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from data_synth.operator.operator_spec import (
    LEVER_GAIN_SD,
    MISALIGNED_SD_RAD,
    SPREAD,
    TIMING_SD_S,
    OperatorSpec,
)
from data_synth.operator.simulated_operator import RATE_HZ
from dvf_ig.report.style import png_bytes
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials, refusals
from dvf_ig.study.operators import lesion, pellets, tasks
from dvf_ig.study.operators.closed_loop import (
    ABLATIONS,
    BEATING,
    CYCLE_S,
    DEVICE,
    HAPTICS,
    HEART_SEED,
    MONO_NOISE,
    MOTION,
    NO_HAPTICS,
    TASKS,
    UNATTENDED,
    Condition,
    OperatingHeart,
    operating_heart,
    surface_of,
)
from dvf_ig.study.operators.figure import operators_figure, operators_shown
from dvf_ig.study.operators.lesion import ablate, lesion_measures
from dvf_ig.study.operators.paper import figures_of
from dvf_ig.study.operators.pellets import (
    cut,
    cutting_law,
    cutting_measures,
    dissect,
    dissection_law,
    dissection_measures,
)
from dvf_ig.study.operators.summary import MEASURES, Difference, OperatorsSummary, Row, summarise_operators
from dvf_ig.study.operators.tasks import (
    automatic,
    track,
    tracked_place,
    tracking_law,
    tracking_measures,
)
from dvf_ig.study.options import option, seed_option, seeds_option
from dvf_ig.study.statistics import estimate_text


class TaskName(StrEnum):
    """Evaluation tasks."""

    cutting = "cutting"
    dissection = "dissection"
    tracking = "tracking"
    lesion = "lesion"


@dataclass(frozen=True, kw_only=True)
class OperatorsSettings:
    """Options of the study."""

    task: TaskName = option("What the operators do.")
    seeds: int = seeds_option(20)
    seed: int = seed_option(1001)


Measures = dict[str, float]


def operators_trial(settings: Settings, seed: int) -> Line:
    """All conditions of settings["task"], and the ablations of cutting.

    Returns:
        conditions, ablations: measures by name of the condition.
    """
    task, heart = str(settings["task"]), operating_heart()
    measures = {c.name: measured(heart, task, c, seed) for c in TASKS[task]}
    line: dict[str, Any] = {"conditions": measures}
    if task == "cutting":
        shared = {name: f"{BEATING}, {name}" for name in (NO_HAPTICS, HAPTICS, UNATTENDED)}
        line["ablations"] = {
            c.name: measures[shared[c.name]] if c.name in shared else measured(heart, task, c, seed)
            for c in ABLATIONS
        }
    return line


def measured(heart: OperatingHeart, task: str, condition: Condition, seed: int) -> Measures:
    """Measures of one operator under one condition."""
    if task == "cutting":
        return cutting_measures(cut(heart, condition, seed))
    if task == "dissection":
        return dissection_measures(dissect(heart, condition, seed))
    if task == "lesion":
        return lesion_measures(ablate(heart, condition, seed))
    place = tracked_place(heart, surface_of(HEART_SEED), seed)
    return tracking_measures(track(heart, place, condition, seed))


def operators_settings(task: str) -> Settings:
    """Settings that a study's folder is bound to."""
    every = [*TASKS[task], *(ABLATIONS if task == "cutting" else ())]
    return {"task": task, "heart": HEART_SEED, "conditions": [asdict(c) for c in every]}


def assumptions(task: str) -> list[str]:
    """One sentence each: of the operators, the force, and the task."""
    s = OperatorSpec()
    hand, d = s.hand, DEVICE
    return [
        "Simulated operators: no person took part. One number is fitted to the paper: how badly depth is "
        "seen in mono, by Table I without a force; every other figure is a prediction of the model.",
        f"Hand {hand.mass_kg:g} kg, {hand.damping_n_s_per_m:g} N·s/m, {hand.stiffness_n_per_m:g} N/m on a "
        f"simulated {d.name} ({1000 * d.mass_kg:g} g, {d.dry_n:g} N dry friction, {d.resolution_mm:g} mm "
        f"sensor step); tremor {s.tremor_rms_mm:g} mm RMS at 8–12 Hz.",
        f"Vision: delay {1000 * s.visual_delay_s:g} ms, crossover {s.crossover_rad_s:g} rad/s, depth error "
        f"{s.depth_noise_mm:g} mm RMS along the line of sight, {s.sideways_noise_mm:g} mm across it, "
        f"{s.noise_hz[0]:g}–{s.noise_hz[1]:g} Hz; the operator's own plan is foreseen, "
        f"{100 * s.anticipated_share:g} % of the target's beat too, at {1000 * TIMING_SD_S:g} ms (SD).",
        f"Felt force: read after {1000 * s.haptic_delay_s:g} ms with an error of {s.force_noise_n:g} N and "
        f"{100 * s.weber:g} %, by an operator who has learnt the fixture, and weighed against vision by the "
        "variances; 'not attended to': the force moves the hand, and the operator makes nothing of it.",
        f"Between operators parameters spread by {100 * SPREAD:g} % (SD of the logarithm), drawn by the "
        "seed; the same operator, with the same errors of judgement, does a task under every condition.",
        f"One heart (phantom {HEART_SEED}, {MOTION}, cycle {CYCLE_S:g} s); registration, phase and tracking "
        f"are exact unless a row says otherwise; the tissue offers no resistance; operator {RATE_HZ} Hz, "
        "servo 1 kHz with passivity controller, supervisor and slew limit.",
        *_of_task(task),
    ]


def _of_task(task: str) -> list[str]:
    q = pellets
    if task == "cutting":
        region = cutting_law()
        return [
            f"Cutting: {q.PELLETS} pellets, each pushed from the surface to {q.DEPTH_MM:g} mm under it, held "
            f"there {q.HOLD_S:g} s, seen along the way in; a pellet's depth is the largest of the tip under "
            f"the true surface; forbidden region from {q.DEPTH_MM:g} mm on, γ {region.gamma_per_mm:.2f}/mm, "
            f"{region.cap_n:g} N; perforation: a pellet {q.PERFORATION_MM:g} mm beyond it."
        ]
    if task == "dissection":
        pull = dissection_law()
        return [
            f"Dissection: {q.PELLETS} pellets with centres {q.HEIGHT_MM:g} mm above the organ, "
            f"which stands still; removed after {q.REMOVED_AFTER_S:g} s within {q.REACH_MM:g} mm, however "
            f"long that takes; guidance to the pellets' height, δ {pull.delta_mm:.2f} mm, m {pull.m:g}, "
            f"{pull.cap_n:g} N.",
            f"Fulcrum: one of {q.FULCRA}; instrument of {q.LENGTH_MM:g} mm, {q.INSIDE_MM:g} mm inside at the "
            f"first pellet; believed lever wrong by {100 * LEVER_GAIN_SD:g} % (SD), image turned by "
            f"{MISALIGNED_SD_RAD * 57.29578:.0f}° (SD); camera 30° from the instrument; mono: depth error × "
            f"{MONO_NOISE:g}.",
        ]
    law = tracking_law()
    if task == "lesion":
        t, (pull, wall) = lesion, lesion.lesion_laws()
        return [
            f"Lesion: {t.LESION_MM:g} mm of the beating surface at up to {t.SPEED_MM_S:g} mm/s; "
            "guidance to the line as drawn at end-diastole, beating with the model, "
            f"δ {pull.delta_mm:.2f} mm, m {pull.m:g}, {pull.cap_n:g} N; behind it a still oesophagus of "
            f"radius {t.TUBE_MM:g} mm, {t.GAP_MM:g} mm from the line at its closest, forbidden with γ "
            f"{wall.gamma_per_mm:.2f}/mm from {t.MARGIN_MM:g} mm before its surface on; the heart's outer "
            "surface represents an atrium's wall, which the phantom lacks."
        ]
    return [
        f"Tracking: {tasks.CYCLES} cycles at one of the automatic kind's places, drawn by the operator's "
        f"seed; guidance δ {law.delta_mm:.2f} mm, m {law.m:g}, {law.cap_n:g} N. Automatic: the stylus in "
        "nobody's hand at all places (`dvf-ig study tracking`). The paper does not say what its manual "
        "figure was measured with."
    ]


def run(settings: OperatorsSettings, driver: Driver) -> Result:
    """Let every operator do the task under every condition."""
    task = settings.task.value
    seeds = range(settings.seed, settings.seed + settings.seeds)
    lines = driver.trials(Trials("operators", operators_settings(task), operators_trial), seeds)
    result, assumed, paper = summarise_operators(task, lines), assumptions(task), figures_of(task)
    alone = automatic(surface_of(HEART_SEED)) if settings.task is TaskName.tracking else None
    summary = {
        **asdict(result),
        "seed": settings.seed,
        "seeds": settings.seeds,
        "automatic": alone,
        "paper": paper,
        "assumptions": assumed,
    }
    files: dict[str, Any] = {"summary.json": summary}
    if result.operators:
        files[f"{task}.png"] = png_bytes(operators_figure(operators_shown(result, lines, assumed)), dpi=120)
    remarks = tuple(f"assumed: {sentence}" for sentence in assumed)
    return Result(summary, _table(result, alone, paper), files, refusals(lines), remarks)


def _table(result: OperatorsSummary, alone: dict[str, float] | None, paper: dict[str, str]) -> Rows:
    shown = MEASURES[result.task]
    rows: Rows = [
        (f"{result.operators} simulated operators", *shown, "Ren 2008"),
        *((*_cells(row, shown), paper[row.condition]) for row in result.rows),
    ]
    if alone is not None:
        numbers = (f"{alone[name]:.2f}" for name in shown)
        rows.append(("automatic, in nobody's hand", *numbers, paper["automatic"]))
    rows += [("",), ("paired difference to visual only", "mean", "relative", "d_z", "better")]
    rows += [_difference_cells(d) for d in result.differences]
    if result.ablations:
        more = (*shown, "withheld_s")
        rows += [("",), ("ablations, beating heart", *more)]
        rows += [_cells(row, more) for row in result.ablations]
    return rows


def _cells(row: Row, shown: tuple[str, ...]) -> tuple[str, ...]:
    return (row.condition, *(estimate_text(row.measures[name], to=" to ") for name in shown))


def _difference_cells(d: Difference) -> tuple[str, ...]:
    relative = "–" if d.relative is None else f"{100 * d.relative:+.0f} %"
    mean, size = estimate_text(d.mean, to=" to "), estimate_text(d.effect_size, to=" to ")
    return (f"{d.measure}: {d.condition}", mean, relative, size, f"{d.better} of {d.of}")


STUDY = Study(OperatorsSettings, run, outputs=lambda settings: ("summary.json", f"{settings.task.value}.png"))
