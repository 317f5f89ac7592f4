"""Make the figures and tables of Ren 2008 from this model, and one page of them; see `scripts/figures`."""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from skimage.measure import find_contours

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.mr.cine import MrProtocol, cine_preop
from data_synth.operator.hand import perpendicular
from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.views import VIEW_PROBE, standard_view
from dvf_ig.core import FloatArray, Rigid
from dvf_ig.guidance import DEVICES, Evaluator, Gaussian, Sigmoid
from dvf_ig.io import write_text
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.preop import phase_errors
from dvf_ig.report.plane_overlay import plane_section
from dvf_ig.study.bench.timing import time_batches, time_calls
from dvf_ig.study.operators import paper
from dvf_ig.study.operators.closed_loop import (
    ACCESS,
    BEATING,
    HEART_SEED,
    MOTION,
    STILL,
    TASKS,
    UNATTENDED,
    OperatingHeart,
    operating_heart,
    surface_of,
)
from dvf_ig.study.operators.pellets import pellet_trial
from dvf_ig.study.operators.study import measured
from dvf_ig.study.operators.tables import Subjects, operators_subjects, paper_table
from dvf_ig.study.operators.tasks import CYCLES, track, tracked_place
from dvf_ig.study.tracking.stylus import BeatingSurface, StylusRun, hold_stylus, with_fixture
from scripts.paper_figures import (
    HeartView,
    PaperFigure,
    PaperTable,
    Section,
    Slice,
    dilation_distance_mm,
    exponent_figure,
    force_over_time,
    held_figure,
    over_time_figure,
    paper_html,
    scene_figure,
    slice_figure,
    steepness_figure,
    tracking_errors_figure,
    width_figure,
    write_paper_figures,
)

FORBIDDEN, GUIDANCE = Sigmoid(1.0), Gaussian(3.0, 1.0)
FIRST_OPERATOR = 1001
ROWS_I, ROWS_III = 6, 5
"""Operators with a row of their own, as many as the paper has people."""
VIEW = "epicardial short-axis"
ARROW_MM, SHOWN_N = 7.0, 0.03
PHASES_SHOWN = (0.0, 0.2, 0.4, 0.7)
TIMED_POINTS, BATCH = 20_000, 1_000
TITLES = {
    "fig03-mr": ("Fig. 3", "A slice of the (simulated) MR with the segmented surface as a thin line."),
    "fig04-distance": (
        "Fig. 4",
        "The signed distance by dilation, as the paper makes it, on the same slice: brightest on the "
        "surface. "
        "The steps along the axes give its diamond shapes; the models here use exact distances instead.",
    ),
    "fig05-forbidden": ("Fig. 5", "Sigmoid potential of a forbidden region, γ = 1 /mm: 1 inside, 0 outside."),
    "fig07-cutting": (
        "Fig. 7",
        "Depth-controlled cutting: ten pellets, each to be pushed 5 mm into the heart.",
    ),
    "fig08-gamma": (
        "Fig. 8",
        "Half of the largest force at the surface, whatever γ; the larger γ, the steeper.",
    ),
    "fig09-m": ("Fig. 9", "The larger m, the flatter the free workspace of ± 1 mm and the steeper its wall."),
    "fig10-delta": ("Fig. 10", "The larger δ, the wider the free zone."),
    "fig11-guidance": (
        "Fig. 11",
        "Gaussian potential of guidance on the slice of Fig. 4, δ = 3 mm, m = 1: zero on the surface.",
    ),
    "fig12-dissection": (
        "Fig. 12",
        "Dissection: ten pellets 1 mm above the surface, the instrument through its fulcrum (yellow).",
    ),
    "fig13-dynamic": (
        "Fig. 13",
        "A tip that nobody holds stays on the beating surface, here where that moves most.",
    ),
    "fig14-automatic": (
        "Fig. 14",
        "Automatic tracking: a simulated PHANToM Premium held by guidance alone where the surface moves "
        "most.",
    ),
    "fig15-manual": (
        "Fig. 15",
        "Manual tracking by one simulated operator with force; the paper does not say with what its own "
        "was done.",
    ),
    "fig16-ultrasound": (
        "Fig. 16",
        "The model's surface and its forbidden region on a (simulated) ultrasound image of the same heart, "
        "at the true pose: what a registration leaves is shown by `dvf-ig replay`.",
    ),
    "eq10-11-over-time": (
        "Equations 10–11 (no figure in the paper)",
        "Where the surface moves most; a vertical line is a volume. As printed, the equation gives the next "
        "volume's force at each volume's own time and jumps; the corrected form is continuous.",
    ),
}


def main() -> int:
    arguments = _arguments()
    surface, heart = surface_of(HEART_SEED), operating_heart()
    automatic = hold_stylus(
        surface, with_fixture(DEVICES["premium"], "force", compensate=False), cycles=arguments.cycles
    )
    figures = _figures(surface, heart, automatic)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_paper_figures(arguments.out, figures)
    tables = _tables(surface, heart, automatic, arguments.operators)
    write_text(arguments.out / "index.html", paper_html(figures, tables))
    for each in tables:
        _print(each)
    print(f"wrote {arguments.out}/index.html and {len(figures)} figures as PNG and SVG", file=sys.stderr)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/figures"))
    parser.add_argument("--cycles", type=int, default=CYCLES, help="cycles of automatic tracking")
    parser.add_argument("--operators", type=int, default=10, help="simulated operators (at least 3)")
    return parser.parse_args()


def _print(shown: PaperTable) -> None:
    widths = [max(len(row[k]) for row in shown.rows if k < len(row)) for k in range(len(shown.rows[0]))]
    print(f"\n{shown.title}")
    for row in shown.rows:
        print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False)).rstrip())
    for sentence in shown.meanings:
        print(f"- {sentence}")


# ------------------------------------------------------------------ figures


def _figures(surface: BeatingSurface, heart: OperatingHeart, automatic: StylusRun) -> list[PaperFigure]:
    """Draw the figures in the order of the paper."""
    anatomy = phantom_anatomy(motion=MOTION, mismatch_mm=0.0, seed=HEART_SEED)
    model = surface.model
    drawn = {
        **_slices(surface, anatomy),
        "fig07-cutting": _pellets(heart, "cutting"),
        "fig08-gamma": steepness_figure(),
        "fig09-m": exponent_figure(),
        "fig10-delta": width_figure(),
        "fig11-guidance": _potential(surface, GUIDANCE, "Potential of guidance"),
        "fig12-dissection": _pellets(heart, "dissection"),
        "fig13-dynamic": _held(surface, automatic),
        "fig14-automatic": tracking_errors_figure(
            automatic.t_s, automatic.distance_mm[-1], "Automatic tracking", paper.AUTOMATIC_MM
        ),
        "fig15-manual": _manual(heart, surface),
        "fig16-ultrasound": _ultrasound(surface, anatomy),
        "eq10-11-over-time": over_time_figure(force_over_time(model, surface.starts_mm[-1], FORBIDDEN)),
    }
    return [PaperFigure(name, *TITLES[name], figure) for name, figure in sorted(drawn.items(), key=_last)]


def _last(item: tuple[str, Figure]) -> tuple[bool, str]:
    return item[0].startswith("eq"), item[0]


def _level(surface: BeatingSurface) -> tuple[float, FloatArray]:
    """Height of the axial slice through the middle of the heart, and the surface's segments there."""
    mesh = surface.model.reference[surface.model.ed_phase]
    low, high = mesh.vertices_mm[:, 2].min(), mesh.vertices_mm[:, 2].max()
    level = 0.5 * float(low + high) + 1e-3  # no vertex lies there
    return level, plane_section(mesh.vertices_mm[mesh.triangles], 2, level)[..., :2]


def _slices(surface: BeatingSurface, anatomy: PhantomAnatomy) -> dict[str, Figure]:
    preop = cine_preop(anatomy, np.random.default_rng(HEART_SEED), MrProtocol(phases=2))
    assert preop.mr is not None
    assert preop.labels is not None
    grid, (level, contour) = preop.mr.grid, _level(surface)
    pitch = float(grid.spacing_mm[0])
    k = round((level - float(grid.origin_mm[2])) / pitch)
    low = grid.origin_mm - 0.5 * pitch
    across, back = (float(low[a] + pitch * grid.shape[a]) for a in (0, 1))
    extent = (float(low[0]), across, back, float(low[1]))
    distance = dilation_distance_mm(preop.labels.values[0] > 0, pitch)
    mr = Slice(preop.mr.values[0, :, :, k].T.astype(np.float64), extent, contour)
    field = Slice(-np.abs(distance[:, :, k].T), extent, np.empty((0, 2, 2)))
    return {
        "fig03-mr": slice_figure(mr, "MR slice, end-diastole, with the segmented surface"),
        "fig04-distance": slice_figure(field, "Distance by dilation", "− |signed distance|, mm"),
        "fig05-forbidden": _potential(surface, FORBIDDEN, "Potential of a forbidden region"),
    }


def _potential(surface: BeatingSurface, law: Sigmoid | Gaussian, title: str) -> Figure:
    """Draw a law's potential on the slice, as far as the model reaches."""
    model, (level, _) = surface.model, _level(surface)
    low, high = (np.asarray(v, dtype=np.float64)[:2] for v in (model.origin_mm + 0.5, model.upper_mm - 0.5))
    x, y = (np.arange(low[a], high[a], 0.5) for a in (0, 1))
    xx, yy = np.meshgrid(x, y)
    points = np.column_stack([xx.ravel(), yy.ravel(), np.full(xx.size, level)])
    distance = Evaluator(model, law).force(points, model.ed_phase / model.phases).distance_mm
    potential = np.abs(law.potential(distance)).reshape(xx.shape)
    extent = (float(x[0]), float(x[-1]), float(y[-1]), float(y[0]))
    shown = Slice(potential, extent, np.empty((0, 2, 2)))
    return slice_figure(shown, title, "potential, share of the largest force", limits=(0.0, 1.0))


def _pellets(heart: OperatingHeart, task: str) -> Figure:
    loop, trial = pellet_trial(heart, task, TASKS[task][0], FIRST_OPERATOR)
    above_mm = 1.0  # half of a pellet is seen where it lies on the surface
    pellets = np.array([site.point_mm + above_mm * site.normal for site in trial.pellets.sites])
    if loop.fulcrum is None:
        along = np.linspace(0.0, 45.0, 2)[:, None] * trial.pellets.sites[0].normal
        tool, title = pellets[0] + along, "Ten pellets to push 5 mm into the heart"
    else:
        beyond = loop.fulcrum.point_mm + 0.3 * (loop.fulcrum.point_mm - pellets[0])
        tool, title = (
            np.array([pellets[0], loop.fulcrum.point_mm, beyond]),
            "Ten pellets to remove, and a fulcrum",
        )
    truth = heart.truth
    toward = _aside(ACCESS) if loop.fulcrum is not None else ACCESS
    return scene_figure(HeartView(truth.at(0.0), truth.triangles, toward, pellets, tool), title)


def _aside(direction: FloatArray) -> FloatArray:
    """Direction turned so that what comes along it is seen from the side."""
    turned = direction + 0.9 * np.cross(direction, np.array([0.0, 0.0, 1.0]))
    return np.asarray(turned / np.linalg.norm(turned))


def _held(surface: BeatingSurface, automatic: StylusRun) -> Figure:
    """Draw the third beat: the start has settled."""
    outward, tips, truth = automatic.outward[-1], automatic.tip_mm[-1], surface.truth
    along = perpendicular(outward, np.array([0.0, 0.0, 1.0]))
    axes = np.stack([along, outward, np.cross(along, outward)])
    cycle_s, sections = surface.model.timing.rr_s, []
    first = tips[int(np.searchsorted(automatic.t_s, 2.0 * cycle_s))]
    for phase in PHASES_SHOWN:
        tip = tips[int(np.searchsorted(automatic.t_s, (2.0 + phase) * cycle_s))]
        vertices = (truth.at(phase) - tip) @ axes.T
        segments = plane_section(vertices[truth.triangles], 2, 1e-4)[..., :2]
        in_plane = axes[:2] @ (tip - first)
        sections.append(Section(f"{100 * phase:.0f} % of the beat", segments + in_plane, in_plane))
    tool = np.array([first, first + 45.0 * outward])
    view = HeartView(truth.at(0.0), truth.triangles, _aside(outward), np.empty((0, 3)), tool)
    return held_figure(view, sections, "Held to the beating surface by the dynamic fixture alone")


def _manual(heart: OperatingHeart, surface: BeatingSurface) -> Figure:
    condition = TASKS["tracking"][1]
    trace = track(heart, tracked_place(heart, surface, FIRST_OPERATOR), condition, FIRST_OPERATOR)
    return tracking_errors_figure(trace.t_s, trace.depth_mm, "Manual tracking", paper.MANUAL_MM)


def _ultrasound(surface: BeatingSurface, anatomy: PhantomAnatomy) -> Figure:
    probe = PROBES[VIEW_PROBE[VIEW]]
    assert isinstance(probe, SectorProbe)
    pose = standard_view(VIEW, anatomy.reference)
    image = simulate_frame(anatomy, probe, pose, np.zeros(probe.lines), seed=HEART_SEED, frame=0)
    (width, height), apex = probe.mm_per_px, np.array(probe.apex_px)
    left, top = -apex * probe.mm_per_px
    extent = (left, left + width * probe.columns, top + height * probe.rows, top)
    forbidden = Evaluator(surface.model, FORBIDDEN)
    x, y = left + width * np.arange(probe.columns), top + height * np.arange(probe.rows)
    distance = _in_plane(forbidden, pose, *np.meshgrid(x, y)).distance_mm.reshape(probe.rows, probe.columns)
    lines = [
        line[:, ::-1] * (width, height) + (left, top)
        for line in find_contours(np.nan_to_num(distance, nan=-99.0), 0.0)
    ]
    contour = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    arrows = np.meshgrid(np.arange(x[0], x[-1], ARROW_MM), np.arange(y[0], y[-1], ARROW_MM))
    force = _in_plane(forbidden, pose, *arrows).force_n @ pose.rotation
    places = np.column_stack([a.ravel() for a in arrows])
    pixels = np.round((places - (left, top)) / probe.mm_per_px).astype(int)
    seen = image[pixels[:, 1].clip(0, probe.rows - 1), pixels[:, 0].clip(0, probe.columns - 1)] > 0
    felt = (np.linalg.norm(force, axis=1) > SHOWN_N) & seen
    shown = Slice(image.astype(np.float64), extent, contour, "across, mm", "depth, mm")
    return slice_figure(shown, f"Model on ultrasound: {VIEW}", force=(places[felt], force[felt, :2]))


def _in_plane(evaluator: Evaluator, pose: Rigid, x: FloatArray, y: FloatArray) -> Any:
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return evaluator.force(pose.apply_array(points), 0.0)


# ------------------------------------------------------------------ tables


def _tables(
    surface: BeatingSurface, heart: OperatingHeart, automatic: StylusRun, operators: int
) -> list[PaperTable]:
    cutting, dissection = (_lines(heart, task, operators) for task in ("cutting", "dissection"))
    label = f"{operators} simulated operators"
    still, beating = (operators_subjects("cutting", cutting, of)["I"] for of in (STILL, BEATING))
    times = operators_subjects("dissection", dissection)
    return [
        PaperTable(
            "Table I: depth-controlled cutting",
            paper_table("I", still, label, ROWS_I),
            _meaning_of_depths(still, beating),
        ),
        PaperTable("Table II: accuracy and speed", _table_ii(surface), MEANING_II),
        PaperTable(
            "Table III: dissection through a fulcrum",
            paper_table("III", times["III"], label, ROWS_III),
            _meaning_of_times(times["III"]),
        ),
        PaperTable(
            "Table IV: dissection, mono and stereo",
            paper_table("IV", times["IV"], label, ROWS_III),
            _meaning_of_sight(times["IV"]),
        ),
        PaperTable("Figures 14 and 15: tracking", _tracking(automatic), MEANING_TRACKING),
    ]


def _lines(heart: OperatingHeart, task: str, operators: int) -> list[dict[str, Any]]:
    """Measure the operators under all conditions in which the force is attended to."""
    conditions = [one for one in TASKS[task] if not one.name.endswith(UNATTENDED)]
    seeds = range(FIRST_OPERATOR, FIRST_OPERATOR + operators)
    return [{"conditions": {c.name: measured(heart, task, c, seed) for c in conditions}} for seed in seeds]


def _means(subjects: Subjects) -> FloatArray:
    return np.asarray(np.mean([np.array(arms) for arms in subjects.values()], axis=0))


def _meaning_of_depths(still: Subjects, beating: Subjects) -> list[str]:
    here, moving, people = _means(still), _means(beating), paper.DEPTH_MM.mean(axis=0)
    return [
        f"Without force, the variation of 40 other operators is fitted: {people[1, 1]:.2f} mm; "
        f"of these it is {here[1, 1]:.2f} mm. All else is predicted.",
        f"Their mean without force is {here[1, 0] - paper.WANTED_MM:+.2f} mm off the wanted depth, people's "
        f"{people[1, 0] - paper.WANTED_MM:+.2f} mm: a pellet stays where the tip was deepest, and one "
        "who moves to the depth in one go and holds does not stop short, as cautious people do.",
        f"With force they push to {here[0, 0]:.2f} ± {here[0, 1]:.2f} mm, people to {people[0, 0]:.2f} ± "
        f"{people[0, 1]:.2f} mm. In both the force ends the excess; an operator draws back after half a "
        "second wherever the tip seems to be. People may push on until they feel the wall: that would "
        "explain why fewer of the people's pellets end too high.",
        f"On a beating heart: {moving[0, 0]:.2f} ± {moving[0, 1]:.2f} mm with and {moving[1, 0]:.2f} ± "
        f"{moving[1, 1]:.2f} mm without force; the paper's people cut a heart that stood still.",
    ]


def _meaning_of_times(times: Subjects) -> list[str]:
    here, people = _means(times), paper.DISSECTION_S.mean(axis=(0, 2))
    return [
        "Erratum: the paper prints a mean of 42 ± 41 s with force and 55 % less; its own rows give "
        f"{people[0]:.1f} s and {100 * (1 - people[0] / people[1]):.0f} % less.",
        f"Predicted without any fit to times: {100 * (1 - here[0] / here[1]):.0f} % less with force. "
        f"Guidance saves "
        "the search for the pellet's depth, the part of the time that errors of sight make; an operator "
        "does not "
        "hesitate, pause or learn, so its times vary less and never reach the people's longest trials.",
    ]


def _meaning_of_sight(times: Subjects) -> list[str]:
    here, people = _means(times), paper.SIGHT_S.mean(axis=0)
    printed = "42.3, 71.3, 37.6 and 67.6 s"
    rows = ", ".join(f"{v:.1f}" for v in people)
    stereo, own = (100 * (1 - one[2:].mean() / one[:2].mean()) for one in (people, here))
    saved, own_saved = (100 * (1 - one[::2] / one[1::2]) for one in (people, here))
    return [
        f"Errata: the printed means are {printed}; the rows give {rows} s. The paper prints p < .02 for the "
        "force over both kinds of sight; its rows give the p above.",
        f"Stereo saves people {stereo:.0f} % of the time, not significantly, and operators {own:.0f} %: in "
        "the model stereo is a smaller error of depth and nothing else, so it counts in every trial.",
        f"Force saves people {saved[0]:.0f} % in mono and {saved[1]:.0f} % in stereo, operators "
        f"{own_saved[0]:.0f} % and {own_saved[1]:.0f} %. What an operator gains is the depth that is badly "
        "seen; people gain as much where they see it better: force helps them with more than depth.",
    ]


MEANING_II = (
    "The fit here is exact least squares on exact distances, and not gradient descent on distances by "
    "dilation: "
    "hence the smaller error.",
    "Ren 2008 timed a Pentium IV of 2.3 GHz; today either way of finding the surface is far quicker than "
    "a haptic "
    "period. Times depend on this machine's load.",
)
MEANING_TRACKING = (
    "Friction over the stiffness that a device renders passively decides automatic tracking: a research "
    "arm is "
    "better, a desktop arm worse than the paper's Freedom6S, whose friction the paper does not state.",
)


def _table_ii(surface: BeatingSurface) -> list[tuple[str, ...]]:
    model, mesh = surface.model, surface.model.reference[0]
    rng = np.random.default_rng(0)
    errors = np.concatenate([phase_errors(model, k, 2000, rng).surface_mm for k in range(model.phases)])
    one_us, batch_us = _speed(surface)
    return [
        ("", "here", "Ren 2008, implicit surface", "Ren 2008, covariance tree"),
        ("vertices", f"{len(mesh.vertices_mm)}", "33 967 (heart)", "99 000 (skull)"),
        ("triangles", f"{len(mesh.triangles)}", "90 700", "182 000"),
        ("one force", f"{1e-3 * np.median(one_us):.4f} ms (beating)", "< 0.2 ms (still)", "32.4 ms"),
        ("the same, 99.9 %", f"{1e-3 * np.percentile(one_us, 99.9):.4f} ms", "–", "–"),
        ("one force of a batch", f"{1e-3 * np.median(batch_us):.4f} ms", "–", "–"),
        ("fitted to original surface", f"{errors.mean():.3f} ± {errors.std():.3f} mm", "0.36 ± 0.22 mm", "–"),
        ("model", f"{model.phases} volumes, {model.megabytes:.1f} MB", "20 volumes", "–"),
    ]


def _speed(surface: BeatingSurface) -> tuple[FloatArray, FloatArray]:
    """Time one call from Python and a point in a batch, µs, along a path near the surface."""
    rng = np.random.default_rng(0)
    steps = rng.normal(scale=0.03, size=(TIMED_POINTS, 3))
    points = surface.starts_mm[0] + np.cumsum(steps, axis=0).clip(-6, 6)
    phase = np.arange(TIMED_POINTS) / 600.0
    evaluator = Evaluator(surface.model, FORBIDDEN)
    tick = partial(force_tick, *evaluator.kernel_arguments(Rigid.identity("mr", "tracker")))
    out = np.empty(7)
    calls = [(point, phi, 0, out) for point, phi in zip(points, phase.tolist(), strict=True)]
    one_us = time_calls(tick, calls, 1)
    batch_us = time_batches(
        lambda begin, end: evaluator.force(points[begin:end], phase[begin:end]), TIMED_POINTS, BATCH, 5
    )
    return np.asarray(one_us), np.asarray(batch_us)


def _tracking(automatic: StylusRun) -> list[tuple[str, ...]]:
    surface = surface_of(HEART_SEED)
    rows: list[tuple[str, ...]] = [("mean error over all places", "here", "Ren 2008")]
    for device in DEVICES.values():
        for compensate in (False, True):
            stylus = with_fixture(device, "force", compensate=compensate)
            run = hold_stylus(surface, stylus, cycles=round(automatic.t_s[-1] / surface.model.timing.rr_s))
            extra = " with friction feed-forward" if compensate else ""
            mean_mm = run.summary()["mean_mm"]
            rows.append(
                (f"automatic, {device.name}{extra}", f"{mean_mm:.2f} mm", f"{paper.AUTOMATIC_MM:.2f} mm")
            )
    return rows


if __name__ == "__main__":
    sys.exit(main())
