"""Make the figures and Table II of Ren 2008 from this model, and one page of them; see `scripts/figures`."""

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core import Rigid
from dvf_ig.guidance import DEVICES, Evaluator, Gaussian, Sigmoid
from dvf_ig.guidance.blend import BLEND_CODES
from dvf_ig.io import write_text
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.report.paper import (
    PaperFigure,
    SurfaceFit,
    exponent_figure,
    field_figure,
    force_over_time,
    organ_field,
    over_time_figure,
    paper_html,
    steepness_figure,
    surface_field,
    surface_figure,
    surface_fit,
    width_figure,
    write_paper_figures,
)
from dvf_ig.study.bench.timing import time_batches, time_calls
from dvf_ig.study.tracking.study import tracking_figure
from dvf_ig.study.tracking.stylus import BeatingSurface, StylusRun, beating_surface, held_styli, hold_stylus

Row = tuple[str, str, str]

FORBIDDEN, GUIDANCE = Sigmoid(1.0), Gaussian(3.0, 1.0)
CAPTIONS = {
    "fig04-surface": (
        "After Fig. 4 (content inferred)",
        "The surface on which the fitted spline's potential is 0.5, against the surface it was fitted to.",
    ),
    "fig05-forbidden-region": (
        "After Fig. 5",
        "A forbidden region pushes out of the organ: γ = 1 /mm, largest force 0.6 N. Arrows are forces "
        "(those that lean out of the slice look shorter), the orange line is the surface.",
    ),
    "fig08-gamma": (
        "After Fig. 8",
        "Half of the largest force at the surface, whatever γ; the larger γ, the steeper.",
    ),
    "fig09-m": (
        "After Fig. 9",
        "The larger m, the flatter the free zone within δ and the steeper its wall.",
    ),
    "fig10-delta": ("After Fig. 10", "The larger δ, the wider the free zone."),
    "fig11-guidance": (
        "After Fig. 11",
        "Guidance pulls back to the surface from either side, and does not act on it: δ = 3 mm, m = 1, "
        "largest force 0.6 N.",
    ),
    "eq10-11-over-time": (
        "Equations 10–11 (no figure in the paper)",
        "Where the surface moves most; a vertical line is a volume. As printed, the equation gives the next "
        "volume's force at each volume's own time and jumps; the corrected form is continuous.",
    ),
}
TIMED_POINTS, BATCH = 20_000, 1_000


def main() -> int:
    arguments = _arguments()
    surface = beating_surface("paper5mm", places=arguments.places, seed=arguments.seed)
    fit = surface_fit(surface.model, phase=surface.model.ed_phase, rng=np.random.default_rng(0))
    tracks = [
        hold_stylus(surface, stylus, cycles=arguments.cycles)
        for stylus in held_styli(list(DEVICES.values()), list(BLEND_CODES))
    ]
    figures = _figures(surface, fit, tracks)
    rows = [*_accuracy(surface, fit), *_tracking(tracks), *_speed(surface)]
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_paper_figures(arguments.out, figures)
    write_text(arguments.out / "index.html", paper_html(figures, rows))
    width = max(len(name) for name, _, _ in rows)
    for name, here, paper in rows:
        print(f"{name:<{width}}  {here:>24}  {paper}")
    print(f"wrote {arguments.out}/index.html and {len(figures)} figures as PNG and SVG", file=sys.stderr)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/figures"))
    parser.add_argument("--cycles", type=int, default=30, help="cycles of automatic tracking (the paper: 30)")
    parser.add_argument("--places", type=int, default=6, help="places on the surface")
    parser.add_argument("--seed", type=int, default=1, help="of the synthetic heart")
    return parser.parse_args()


def _figures(surface: BeatingSurface, fit: SurfaceFit, tracks: list[StylusRun]) -> list[PaperFigure]:
    """Draw the figures in the order of the paper."""
    model, cycle_s = surface.model, surface.model.timing.rr_s
    forbidden, guidance = Evaluator(model, FORBIDDEN), Evaluator(model, GUIDANCE)
    drawn = {
        "fig04-surface": surface_figure(fit),
        "fig05-forbidden-region": _field(forbidden, "Force of a forbidden region: out of the organ"),
        "fig08-gamma": steepness_figure(),
        "fig09-m": exponent_figure(),
        "fig10-delta": width_figure(),
        "fig11-guidance": _field(guidance, "Force of guidance: back to the surface from either side"),
        "eq10-11-over-time": over_time_figure(force_over_time(model, surface.starts_mm[-1], FORBIDDEN)),
        "fig14-tracking": tracking_figure(tracks, motion=surface.motion, cycle_s=cycle_s),
    }
    text = {**CAPTIONS, "fig14-tracking": ("After Fig. 14", _tracking_caption(tracks))}
    return [PaperFigure(name, *text[name], figure) for name, figure in drawn.items()]


def _field(evaluator: Evaluator, title: str) -> Figure:
    return field_figure(organ_field(evaluator, 0.0), surface_field(evaluator, 0.0), title)


def _tracking_caption(tracks: list[StylusRun]) -> str:
    devices = {t.stylus.device.name: t.stylus.device for t in tracks}.values()
    each = "; ".join(
        f"{d.name}: {1000 * d.mass_kg:g} g, dry friction {d.dry_n:g} N, sensor step {d.resolution_mm:g} mm"
        for d in devices
    )
    return (
        f"Automatic tracking: a simulated device that nobody holds is kept on the surface by guidance. "
        f"{each}. Feed-forward overcomes the part of the dry friction that passivity does not need."
    )


def _accuracy(surface: BeatingSurface, fit: SurfaceFit) -> list[Row]:
    model, errors = surface.model, fit.errors_mm
    spread = f"{errors.mean():.3f} ± {errors.std():.3f} mm"
    return [
        ("fitted surface to the original, mean ± SD", spread, "0.36 ± 0.22 mm"),
        ("fitted surface to the original, 99 %", f"{np.percentile(errors, 99):.3f} mm", "–"),
        ("model", f"{model.phases} volumes, {model.megabytes:.1f} MB", "20 volumes"),
    ]


def _tracking(tracks: list[StylusRun]) -> list[Row]:
    rows = []
    for track in tracks:
        f = track.stylus
        extra = " with feed-forward" if f.feed_forward.friction_n > 0.0 else ""
        name = f"automatic tracking, {f.device.name}{extra}, blend '{f.blend}', mean"
        rows.append((name, f"{track.summary()['mean_mm']:.3f} mm", "0.29 mm"))
    return rows


def _speed(surface: BeatingSurface) -> list[Row]:
    """Time one call from Python and a point in a batch, along a path near the surface."""
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
    paper = "< 200 µs (static)"
    return [
        ("dynamic force, one call from Python, median", f"{np.median(one_us):.2f} µs", paper),
        ("the same, 99.9 %", f"{np.percentile(one_us, 99.9):.2f} µs", "–"),
        ("dynamic force, a point of a batch", f"{np.median(batch_us):.3f} µs", "–"),
    ]


if __name__ == "__main__":
    sys.exit(main())
