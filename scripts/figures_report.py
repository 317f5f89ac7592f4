"""Make the figures and the table of Ren 2008 from this model, and one page of them; see `scripts/figures`."""

import argparse
import base64
import html
import io
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core import DvfModel, FloatArray, Rigid
from dvf_ig.guidance import DEVICES, Evaluator, Gaussian, PoseAndPhase, Sigmoid
from dvf_ig.guidance.blend import BLEND_CODES
from dvf_ig.io import write_text
from dvf_ig.io.atomic import write_bytes
from dvf_ig.preop import check_model
from dvf_ig.report.paper import dynamic_figure, field_figure, gaussian_figure, sigmoid_figure
from dvf_ig.report.study.stylus import tracking_figure
from dvf_ig.study.stylus.holding import BeatingSurface, StylusRun, beating_surface, held_styli, hold_stylus

Row = tuple[str, str, str]

TITLE = "Dynamic virtual fixtures: the figures of Ren 2008 from this model"
PAGE_PX_PER_INCH = 88
STYLE = (
    "body{font:15px/1.5 sans-serif;margin:2em auto;max-width:1100px;padding:0 1em;color:#222}"
    "figure{margin:2.2em 0}img{max-width:100%}figcaption{color:#555;max-width:52em}"
    "td,th{padding:3px 14px;text-align:left}table{border-collapse:collapse}"
    "tr+tr td{border-top:1px solid #ddd}"
)


def main() -> int:
    arguments = _arguments()
    surface = beating_surface("paper5mm", places=arguments.places, seed=arguments.seed)
    model = surface.model
    tracks = [
        hold_stylus(surface, stylus, cycles=arguments.cycles)
        for stylus in held_styli(list(DEVICES.values()), list(BLEND_CODES))
    ]
    figures = [
        ("sigmoid", "Fig. 4", sigmoid_figure(), "Half of the largest force at the surface, whatever γ."),
        (
            "forbidden-region",
            "Fig. 5",
            field_figure(model, Sigmoid(1.0), "Force of a forbidden region: out of the organ"),
            "γ = 1 /mm, 0.6 N at most. Arrows are forces; those that lean out of the slice look shorter.",
        ),
        ("gaussian", "Fig. 8", gaussian_figure(), "The larger m, the flatter the free zone."),
        (
            "guidance",
            "Fig. 9",
            field_figure(
                model, Gaussian(3.0, 1.0), "Force of guidance: back to the surface from either side"
            ),
            "δ = 3 mm, m = 1, 0.6 N at most. No force on the surface itself.",
        ),
        (
            "dynamic",
            "Fig. 10",
            dynamic_figure(model, surface.starts_mm[-1], Sigmoid(1.0)),
            "Where the surface moves most; a vertical line is a volume. As printed, the equation gives the "
            "next volume's force at each volume's own time and jumps; the corrected form is continuous.",
        ),
        ("tracking", "Fig. 11", tracking_figure(surface, tracks), _tracking_caption(tracks)),
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    parts = [_part(arguments.out, *figure) for figure in figures]
    rows = [*_accuracy(model), *_tracking_rows(tracks), *_speed(model, surface)]
    _print(rows)
    write_text(arguments.out / "index.html", _page(parts, rows))
    print(f"wrote {arguments.out}/index.html and {len(figures)} figures as PNG and SVG", file=sys.stderr)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=TITLE)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/figures"))
    parser.add_argument("--cycles", type=int, default=30, help="cycles of automatic tracking")
    parser.add_argument("--places", type=int, default=6, help="places on the surface")
    parser.add_argument("--seed", type=int, default=1, help="of the phantom")
    return parser.parse_args()


def _part(out: Path, name: str, number: str, figure: Figure, caption: str) -> str:
    """Write PNG and SVG; the page's piece of HTML."""
    png, svg = io.BytesIO(), io.BytesIO()
    figure.savefig(png, format="png", dpi=130)
    figure.savefig(svg, format="svg", metadata={"Date": None})
    write_bytes(out / f"{name}.png", png.getvalue())
    write_bytes(out / f"{name}.svg", svg.getvalue())
    data = base64.b64encode(png.getvalue()).decode()
    width = round(PAGE_PX_PER_INCH * figure.get_size_inches()[0])
    words = f"After {number}. {html.escape(caption)} (<a href='{name}.svg'>SVG</a>)"
    return (
        f"<figure><img alt='{name}' width='{width}' src='data:image/png;base64,{data}'>"
        f"<figcaption>{words}</figcaption></figure>"
    )


def _tracking_caption(tracks: list[StylusRun]) -> str:
    devices = {t.stylus.device.name: t.stylus.device for t in tracks}.values()
    each = "; ".join(
        f"{d.name}: {1000 * d.mass_kg:g} g, dry friction {d.dry_n:g} N, sensor step {d.resolution_mm:g} mm"
        for d in devices
    )
    return f"Nobody holds the tool. {each}. Feed-forward spends friction that passivity does not need."


def _accuracy(model: DvfModel) -> list[Row]:
    found = check_model(model, rng=np.random.default_rng(0))
    return [
        ("fitted surface to the original, mean", f"{found.mean_mm:.3f} mm", "0.36 ± 0.22 mm"),
        ("fitted surface to the original, 99 %", f"{found.p99_mm:.3f} mm", "–"),
        ("model", f"{model.phases} volumes, {model.megabytes:.1f} MB", "20 volumes"),
    ]


def _tracking_rows(tracks: list[StylusRun]) -> list[Row]:
    rows = []
    for track in tracks:
        f, found = track.stylus, track.summary()
        extra = " with feed-forward" if f.feed_forward.friction_n > 0.0 else ""
        name = f"automatic tracking, {f.device.name}{extra}, blend '{f.blend}', mean"
        rows.append((name, f"{found['mean_mm']:.3f} mm", "0.29 mm"))
    return rows


def _speed(model: DvfModel, surface: BeatingSurface) -> list[Row]:
    """Time of one call from Python and of a point in a batch, near the surface; the machine may be busy."""
    rng = np.random.default_rng(0)
    points = surface.starts_mm[0] + np.cumsum(rng.normal(scale=0.03, size=(20_000, 3)), axis=0).clip(-6, 6)
    phase = np.arange(len(points)) / 600.0
    evaluator = Evaluator(model, Sigmoid(1.0))
    tick = PoseAndPhase(Rigid("mr", "tracker", np.eye(3), np.zeros(3))).bind(evaluator)
    calls = _call_times(tick, points, phase)
    batch = min(_seconds(lambda: evaluator.force(points, phase)) for _ in range(5)) / len(points)
    return [
        (
            "dynamic force, one call from Python, median",
            f"{1e6 * np.median(calls):.2f} µs",
            "< 200 µs (static)",
        ),
        ("the same, 99.9 %", f"{1e6 * np.percentile(calls, 99.9):.2f} µs", "–"),
        ("dynamic force, a point of a batch", f"{1e6 * batch:.3f} µs", "–"),
    ]


def _call_times(tick: object, points: FloatArray, phase: FloatArray) -> FloatArray:
    out, times = np.empty(7), np.empty(len(points))
    for k, (point, phi) in enumerate(zip(points, phase.tolist(), strict=True)):
        begin = time.perf_counter()
        tick(point, phi, 0, out)
        times[k] = time.perf_counter() - begin
    return times[1000:]


def _seconds(work: object) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def _print(rows: list[Row]) -> None:
    width = max(len(row[0]) for row in rows)
    for name, ours, paper in rows:
        print(f"{name:<{width}}  {ours:>24}  {paper}")


def _page(parts: list[str], rows: list[Row]) -> str:
    table = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f"<!doctype html><meta charset='utf-8'><title>{TITLE}</title><style>{STYLE}</style><h1>{TITLE}</h1>"
        "<p>A synthetic four-chamber heart whose surface moves 5 mm (paper5mm). The figures show what the "
        "paper's figures are about, by content; they are not copies, and the heart is another one.</p>"
        f"{''.join(parts)}<h2>After Table II: accuracy and speed</h2>"
        f"<table><tr><th></th><th>here</th><th>Ren 2008</th></tr>{table}</table>\n"
    )


if __name__ == "__main__":
    sys.exit(main())
