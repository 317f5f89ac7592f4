"""What is assumed of simulated operators and their tasks; printed with every result."""

from data_synth.operator.operator_spec import (
    LEVER_GAIN_SD,
    MISALIGNED_SD_RAD,
    SPREAD,
    TIMING_SD_S,
    OperatorSpec,
)
from data_synth.operator.simulated_operator import RATE_HZ

from . import cutting, dissection, tracking
from .closed_loop import DEVICE
from .conditions import MONO_NOISE, TASKS
from .heart import CYCLE_S, HEART_SEED, MOTION

UNKNOWN = "not available here"
"""Stands in the paper's column for a figure that this project does not have."""


def assumptions(task: str) -> list[str]:
    """One sentence each: of the operators, the force, and the task."""
    s = OperatorSpec()
    hand, d = s.hand, DEVICE
    return [
        "Simulated operators: no person took part. Nothing is fitted to the paper's tables, whose figures "
        "without haptics are not available here; every figure is a prediction of the model.",
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


def paper_figures(task: str) -> dict[str, str]:
    """What Ren 2008 reports, by condition: two means of tracking; the tables' figures are not known here."""
    if task != "tracking":
        return {condition.name: UNKNOWN for condition in TASKS[task]}
    manual = f"manual {tracking.PAPER_MANUAL_MM:g} mm mean, condition unknown"
    figures = {condition.name: manual for condition in TASKS[task]}
    return {**figures, "automatic": f"{tracking.PAPER_AUTOMATIC_MM:g} mm mean"}


def _of_task(task: str) -> list[str]:
    if task == "cutting":
        region, c = cutting.cutting_law(), cutting
        return [
            f"Cutting: {c.LENGTH_MM:g} mm at up to {c.SPEED_MM_S:g} mm/s, slower where the tip seems "
            f"off its aim; wanted depth and forbidden surface both {c.DEPTH_MM:g} mm under the epicardium; "
            f"forbidden region γ {region.gamma_per_mm:.2f}/mm, {region.cap_n:g} N; perforation: an excursion "
            f"{c.PERFORATION_MM:g} mm beyond it; depths are those of the true surface."
        ]
    if task == "dissection":
        wall, q = dissection.dissection_law(), dissection
        return [
            f"Dissection: {q.PELLETS} pellets with centres {q.HEIGHT_MM:g} mm above the forbidden organ, "
            f"which stands still; removed after {q.REMOVED_AFTER_S:g} s within {q.REACH_MM:g} mm, left after "
            f"{q.GIVEN_UP_S:g} s; forbidden region at the organ's surface, γ {wall.gamma_per_mm:.2f}/mm, "
            f"{wall.cap_n:g} N.",
            f"Fulcrum: instrument of {q.LENGTH_MM:g} mm, {q.INSIDE_MM:g} mm inside at the first pellet; "
            f"believed lever wrong by {100 * LEVER_GAIN_SD:g} % (SD), image turned by "
            f"{MISALIGNED_SD_RAD * 57.29578:.0f}° (SD); camera 30° from the instrument; mono: depth error × "
            f"{MONO_NOISE:g}.",
        ]
    law = tracking.tracking_law()
    return [
        f"Tracking: {tracking.CYCLES} cycles at one of the automatic kind's places, drawn by the operator's "
        f"seed; guidance δ {law.delta_mm:.2f} mm, m {law.m:g}, {law.cap_n:g} N. Automatic: the stylus in "
        "nobody's hand at all places (`dvf-ig study tracking`). What the paper's manual figure was measured "
        "with is not known here."
    ]
