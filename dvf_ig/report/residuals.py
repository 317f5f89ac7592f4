"""Draw calibration residuals, to judge a calibration at a glance.

Blue is in the fit, orange is excluded or the rival, black is the reference. matplotlib is loaded when a
picture is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dvf_ig.core.arrays import BoolArray, FloatArray, frozen
from dvf_ig.core.errors import InvalidInputError

from .style import ESTIMATE, START, TRUTH, open_frame, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dvf_ig.calibration.temporal.latency import LatencyResult

MOST_BARS = 24


def write_residual_picture(
    path: Path | str,
    residuals: FloatArray,
    *,
    title: str,
    used: BoolArray | None = None,
    names: Sequence[str] | None = None,
    second: FloatArray | None = None,
    x_label: str = "pose",
) -> None:
    """Write residuals as a PNG: bars if they are few and named, else dots with their distribution.

    Args:
        path: the file; a suffix other than .png is an error.
        residuals: (n,) lengths, mm; NaN is not drawn.
        title: one line with the result and its error.
        used: (n,) False for items excluded from the fit; None: all were used.
        names: (n,) name of each; bars are drawn for up to MOST_BARS of them.
        second: (n,) error of each item where it was left out of the fit, mm, drawn with the first.
        x_label: of the axis of dots.
    Raises:
        InvalidInputError: arrays of unequal length, no finite residual, or a suffix that is not .png.
        OutputError: not writable.
    """
    values = np.asarray(residuals, dtype=np.float64)
    count = len(values)
    took_part = np.ones(count, dtype=np.bool_) if used is None else frozen(used, "used", (count,), np.bool_)
    took_part = took_part & np.isfinite(values)
    if not took_part.any():
        raise InvalidInputError("there is no finite residual to draw; needed at least one that was used")
    for what, items in (("names", names), ("second residuals", second)):
        if items is not None and len(items) != count:
            raise InvalidInputError(f"{len(items)} {what} for {count} residuals; needed equal numbers")
    if names is not None and count <= MOST_BARS:
        figure = _bars(values, took_part, names, second)
    else:
        figure = _dots(values, took_part, x_label)
    _finish(path, figure, title)


def write_latency_picture(path: Path | str, latency: LatencyResult, *, title: str) -> None:
    """Write a lag as a PNG: both motions after alignment, the correlation curve, and the lag over time.

    Args:
        path: the file, .png.
        latency: the lag with its evidence.
        title: one line with the result.
    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    motion, curve, drift = figure.subplot_mosaic([["a", "a"], ["b", "c"]]).values()
    motions, start = latency.motions, float(latency.motions.video_t_s[0])
    gain, offset, _ = motions.line(latency.lag_s)
    t_s = motions.video_t_s - start
    motion.plot(t_s, (motions.row_px - offset) / gain, "o", ms=3, color=START, label="floor in the images")
    motion.plot(
        t_s,
        motions.moved_mm(latency.lag_s),
        color=ESTIMATE,
        lw=1.2,
        label=f"tracker, shifted by {_ms(latency.lag_s)}",
    )
    motion.set(xlabel="video time, s", ylabel="motion, mm")
    motion.margins(x=0.01, y=0.25)
    motion.legend(loc="upper right", ncols=2, fontsize=9, frameon=False)
    _draw_curve(curve, latency)
    low, high = (1000 * value for value in latency.interval_s)
    drift.axhspan(low, high, color=ESTIMATE, alpha=0.15, lw=0, label="95 % of the mean")
    drift.axhline(1000 * latency.lag_s, color=ESTIMATE, lw=1.2)
    drift.plot(
        latency.period_t_s - start,
        1000 * latency.period_lags_s,
        "o-",
        ms=4,
        lw=0.8,
        color=TRUTH,
        label="each movement",
    )
    drift.set(xlabel="video time, s", ylabel="lag, ms", title="lag of each movement alone")
    drift.margins(y=0.3)
    drift.legend(loc="upper right", ncols=2, fontsize=8, frameon=False)
    _finish(path, figure, title)


def _draw_curve(axis: Axes, latency: LatencyResult) -> None:
    size = np.abs(latency.correlations)
    axis.plot(1000 * latency.lags_s, size, color=TRUTH, lw=1.0)
    for lag, color, word in ((latency.lag_s, ESTIMATE, "taken"), (latency.second_lag_s, START, "rejected")):
        if np.isfinite(lag):
            height = abs(latency.motions.correlation(lag))
            axis.plot(1000 * lag, height, "o", ms=7, color=color, label=f"{word}: {_ms(lag)}, r {height:.3f}")
    axis.set(xlabel="lag, ms", ylabel="|correlation|", ylim=(0, 1.25), title="match at every lag tried")
    axis.set_yticks([0, 0.5, 1.0])
    axis.legend(loc="upper center", ncols=2, fontsize=8, frameon=False, handletextpad=0.2)


def _bars(values: FloatArray, used: BoolArray, names: Sequence[str], second: FloatArray | None) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 1.6 + 0.32 * len(values)), layout="constrained")
    axis = figure.subplots()
    rows = np.arange(len(values))
    axis.barh(rows, values, height=0.6, color=[ESTIMATE if u else START for u in used], label="in the fit")
    if second is not None:
        axis.plot(second, rows, "D", ms=5, color=TRUTH, label="left out of the fit")
    for row, value in enumerate(values):
        axis.annotate(f"{value:.2f}", (0, row), (4, 0), textcoords="offset points", va="center", color="w")
    rms = float(np.sqrt(np.mean(values[used] ** 2)))
    axis.axvline(rms, color=TRUTH, lw=0.9, ls=":", label=f"RMS {rms:.2f} mm")
    axis.set_yticks(rows, list(names))
    axis.invert_yaxis()
    axis.set_xlabel("distance, mm")
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    return figure


def _dots(values: FloatArray, used: BoolArray, x_label: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    over_time, spread = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
    inside = values[used]
    rms, p95 = float(np.sqrt(np.mean(inside**2))), float(np.percentile(inside, 95))
    top = 1.15 * float(inside.max())
    index = np.arange(len(values))
    out = ~used & np.isfinite(values)
    over_time.plot(index[used], inside, ".", ms=4, color=ESTIMATE, label=f"{int(used.sum())} in the fit")
    if out.any():
        top = max(top, min(1.15 * float(values[out].max()), 2.0 * top))
        over_time.plot(
            index[out], np.minimum(values[out], 0.97 * top), "^", ms=4, color=START,
            label=f"{int(out.sum())} left out, up to {values[out].max():.1f} mm",
        )  # fmt: skip
    over_time.set(xlabel=x_label, ylabel="residual, mm", ylim=(0, 1.12 * top))
    over_time.legend(loc="upper left", ncols=2, fontsize=9, frameon=False)
    bins = np.linspace(0.0, float(inside.max()), 31).tolist()
    spread.hist(inside, bins=bins, orientation="horizontal", color=ESTIMATE, alpha=0.7)
    for value, style, word in ((rms, "-", "RMS"), (p95, ":", "95 %")):
        spread.axhline(value, color=TRUTH, lw=1.0, ls=style, label=f"{word} {value:.2f} mm")
    spread.set_xlabel("number")
    spread.legend(loc="upper right", fontsize=9, frameon=False)
    return figure


def _finish(path: Path | str, figure: Figure, title: str) -> None:
    figure.suptitle(title, fontsize=11, color=TRUTH)
    for axis in figure.axes:
        open_frame(axis)
        axis.title.set_fontsize(10)
    write_png(path, figure, dpi=130)


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:+.1f} ms"
