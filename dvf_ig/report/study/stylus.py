"""Figure of a tool held to the beating surface: both along the normal, and the distance between them.

One colour for each device with or without feed-forward; full, dashed and dotted lines for the blends.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dvf_ig.core import BoolArray, FloatArray
from dvf_ig.report.style import SERIES, TRUTH, open_frame, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dvf_ig.guidance import FeedForward, SimulatedDevice
    from dvf_ig.guidance.blend import Blend

STYLES = {"force": "-", "distance": "--", "periodic": ":"}
PAPER_MEAN_MM = 0.29
"""Mean error of automatic tracking in Ren 2008."""


class HeldStylus(Protocol):
    """A device with the fixture that holds it."""

    @property
    def device(self) -> SimulatedDevice: ...
    @property
    def blend(self) -> Blend: ...
    @property
    def feed_forward(self) -> FeedForward: ...


class StylusRun(Protocol):
    """A stylus held at k places over n moments; the last place is where the surface moves most.

    Attributes:
        t_s: (n,) from the start on.
        tip_mm: (k, n, 3) true tip.
        distance_mm: (k, n) of the tip from the true surface, positive inside.
        outward: (k, 3) mean direction out of the organ at the tip.
    """

    @property
    def stylus(self) -> HeldStylus: ...
    @property
    def t_s(self) -> FloatArray: ...
    @property
    def tip_mm(self) -> FloatArray: ...
    @property
    def distance_mm(self) -> FloatArray: ...
    @property
    def outward(self) -> FloatArray: ...


def tracking_figure(
    tracks: Sequence[StylusRun], *, motion: str, cycle_s: float, shown_cycles: int = 3
) -> Figure:
    """Above, the first cycles where the surface moves most; below, the error of everything that followed.

    Args:
        tracks: one for each stylus, at least one, all of the same length.
        motion: how the surface moves.
        cycle_s: length of a cycle.
        shown_cycles: how many cycles are drawn.
    """
    shown = tracks[0].t_s < shown_cycles * cycle_s
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    layout = [["motion", "motion"], ["error", "error"], ["cycles", "spread"]]
    axes: dict[str, Axes] = figure.subplot_mosaic(layout)
    one_blend = _one_blend(tracks)
    _draw_motion(axes["motion"], tracks[0], shown)
    _draw_error(axes["error"], one_blend, tracks, shown)
    _draw_cycles(axes["cycles"], tracks, cycle_s)
    _draw_spread(axes["spread"], tracks)
    for axis in axes.values():
        open_frame(axis)
    handles, labels = axes["cycles"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    cycles = round(len(tracks[0].t_s) / tracks[0].stylus.device.rate_hz / cycle_s)
    figure.suptitle(
        f"Held to the beating surface by the guidance fixture alone: {motion}, "
        f"{cycles} cycles of {cycle_s:g} s, {len(tracks[0].tip_mm)} places"
    )
    return figure


def tracking_png(tracks: Sequence[StylusRun], *, motion: str, cycle_s: float) -> bytes:
    """`tracking_figure` as a PNG file's bytes."""
    return png_bytes(tracking_figure(tracks, motion=motion, cycle_s=cycle_s), dpi=120)


def _group(track: StylusRun) -> str:
    f = track.stylus
    name = f.device.name.removeprefix("PHANToM ")
    return f"{name}, feed-forward" if f.feed_forward.friction_n > 0.0 else name


def _color(track: StylusRun, tracks: Sequence[StylusRun]) -> str:
    groups = list(dict.fromkeys(_group(t) for t in tracks))
    return SERIES[groups.index(_group(track)) % len(SERIES)]


def _one_blend(tracks: Sequence[StylusRun]) -> list[StylusRun]:
    """One track a group, so that curves over time can be told apart: the paper's blend where it was tried."""
    blends = [t.stylus.blend for t in tracks]
    chosen = "force" if "force" in blends else blends[0]
    return [t for t in tracks if t.stylus.blend == chosen]


def _draw_motion(axis: Axes, track: StylusRun, shown: BoolArray) -> None:
    """Along the mean outward normal: the tool, and the surface, which is as far out as the tool is inside."""
    tool = (track.tip_mm[-1] - track.tip_mm[-1, 0]) @ track.outward[-1]
    surface = tool + track.distance_mm[-1]
    axis.plot(track.t_s[shown], surface[shown], color=TRUTH, lw=3.0, alpha=0.35, label="true surface")
    axis.plot(track.t_s[shown], tool[shown], color=SERIES[0], lw=1.4, label=f"tool, {_group(track)}")
    axis.set(ylabel="along the outward\nnormal, mm", title="where the surface moves most")
    axis.title.set_fontsize(10)
    axis.legend(loc="upper right", ncols=4, frameon=False, fontsize=9)
    axis.margins(x=0.0, y=0.2)


def _draw_error(
    axis: Axes, drawn: Sequence[StylusRun], tracks: Sequence[StylusRun], shown: BoolArray
) -> None:
    for track in drawn:
        axis.plot(track.t_s[shown], track.distance_mm[-1][shown], color=_color(track, tracks), lw=1.2)
    axis.axhline(0.0, color=TRUTH, lw=0.8)
    axis.set(xlabel="time, s", ylabel="distance to the true\nsurface, mm (inside > 0)")
    axis.margins(x=0.0)


def _draw_cycles(axis: Axes, tracks: Sequence[StylusRun], cycle_s: float) -> None:
    """Mean error of each cycle over all places: whether it grows, and how soon it settles."""
    for track in tracks:
        mean_mm = float(np.abs(track.distance_mm).mean())
        cycle = np.floor(track.t_s / cycle_s + 1e-9).astype(int)
        means = np.bincount(cycle, weights=np.abs(track.distance_mm).mean(axis=0)) / np.bincount(cycle)
        axis.plot(
            1 + np.arange(len(means)), means, STYLES[track.stylus.blend], lw=1.4,
            color=_color(track, tracks),
            label=f"{_group(track)}, {track.stylus.blend}: {mean_mm:.2f} mm",
        )  # fmt: skip
    axis.axhline(PAPER_MEAN_MM, color=TRUTH, lw=0.9, ls="-.")
    axis.annotate("Ren 2008: 0.29 mm", (1, PAPER_MEAN_MM), (2, 3), textcoords="offset points", fontsize=8)
    axis.set(xlabel="cycle", ylabel="mean |distance|, mm", ylim=(0, None))
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_spread(axis: Axes, tracks: Sequence[StylusRun]) -> None:
    for track in tracks:
        error = np.sort(np.abs(track.distance_mm).ravel())[:: max(1, track.distance_mm.size // 2000)]
        share = np.linspace(0, 100, len(error))
        axis.plot(error, share, STYLES[track.stylus.blend], color=_color(track, tracks), lw=1.4)
    axis.set(xlabel="|distance|, mm", ylabel="share of time below, %", ylim=(0, 101), xlim=(0, None))
