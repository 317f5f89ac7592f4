"""Hold a stylus to the beating surface by a guidance fixture alone, by device and blend.

Distance to the true surface, with and without friction feed-forward (Ren 2008, automatic tracking: 0.29
mm). The unit is the heart; nothing is tuned to this study. Colours are devices with or without feed-
forward; full, dashed and dotted lines the blends.

    dvf-ig study tracking --seeds 5 -o study
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from data_synth import MotionPreset
from dvf_ig.core import BoolArray, part_of
from dvf_ig.guidance import DEVICES, SimulatedDevice
from dvf_ig.guidance.blend import BLEND_CODES
from dvf_ig.report.style import SERIES, TRUTH, open_frame, png_bytes
from dvf_ig.study.driver import Driver, Result, Rows, Study
from dvf_ig.study.options import option, seed_option, seeds_option
from dvf_ig.study.tracking.stylus import (
    HeldStylus,
    StylusRun,
    beating_surface,
    held_styli,
    hold_stylus,
    pool_hearts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Options of the study."""

    motion: MotionPreset = option("How the phantom beats.", "paper5mm")
    cycles: int = option("How many.", 30, least=1)
    cycle_s: float = option("Length of a cycle.", 0.6, least=0.3, most=3.0)
    phases: int = option("Volumes of the model in a cycle.", 20, least=2)
    places: int = option("Places on the surface.", 6, least=1)
    device: Literal["premium", "omni", "both"] = option("What is simulated.", "both")
    seeds: int = seeds_option(1)
    seed: int = seed_option(1)


SHOWN_CYCLES = 3
STYLES = {"force": "-", "distance": "--", "periodic": ":"}
PAPER_MEAN_MM = 0.29
"""Mean error of automatic tracking in Ren 2008."""


def tracking_figure(tracks: Sequence[StylusRun], *, motion: str, cycle_s: float) -> Figure:
    """Above, the first cycles where the surface moves most; below, the error of everything that followed.

    Args:
        tracks: one for each stylus, at least one, all of the same length.
        motion: how the surface moves.
        cycle_s: length of a cycle.
    """
    from matplotlib.figure import Figure

    shown = tracks[0].t_s < SHOWN_CYCLES * cycle_s
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


def _group(track: StylusRun) -> str:
    f = track.stylus
    name = f.device.name.removeprefix("PHANToM ")
    return f"{name}, feed-forward" if f.feed_forward.friction_n > 0.0 else name


def _color(track: StylusRun, tracks: Sequence[StylusRun]) -> str:
    groups = list(dict.fromkeys(_group(t) for t in tracks))
    return SERIES[groups.index(_group(track)) % len(SERIES)]


def _one_blend(tracks: Sequence[StylusRun]) -> list[StylusRun]:
    """One track a group, so that curves over time are distinct: the paper's blend if it was tried."""
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
    from matplotlib.ticker import MaxNLocator

    axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_spread(axis: Axes, tracks: Sequence[StylusRun]) -> None:
    for track in tracks:
        error = np.sort(np.abs(track.distance_mm).ravel())[:: max(1, track.distance_mm.size // 2000)]
        share = np.linspace(0, 100, len(error))
        axis.plot(error, share, STYLES[track.stylus.blend], color=_color(track, tracks), lw=1.4)
    axis.set(xlabel="|distance|, mm", ylabel="share of time below, %", ylim=(0, 101), xlim=(0, None))


def run(settings: TrackingSettings, driver: Driver) -> Result:
    """Hold every stylus to every heart."""
    both = settings.device == "both"
    devices = list(DEVICES.values()) if both else [DEVICES[settings.device]]
    styli = held_styli(devices, list(BLEND_CODES))
    with driver.progress("tracking") as report:
        hearts = [
            beating_surface(
                settings.motion,
                phases=settings.phases,
                cycle_s=settings.cycle_s,
                places=settings.places,
                seed=settings.seed + k,
                progress=part_of(lambda share: report(0.3 * share), k, settings.seeds),
            )
            for k in range(settings.seeds)
        ]
        runs = []
        for stylus in styli:
            runs.append(pool_hearts([hold_stylus(heart, stylus, cycles=settings.cycles) for heart in hearts]))
            report(0.3 + 0.7 * len(runs) / len(styli))
    fields = {
        "motion": settings.motion,
        "cycles": settings.cycles,
        "cycle_s": settings.cycle_s,
        "phases": settings.phases,
        "seed": settings.seed,
        "seeds": settings.seeds,
        "excursion_mm": [mm for heart in hearts for mm in heart.excursion_mm.tolist()],
        "rows": [_entry(one) for one in runs],
    }
    picture = tracking_figure(runs, motion=settings.motion, cycle_s=settings.cycle_s)
    return Result(
        fields,
        _table(runs),
        {"tracking.json": fields, "tracking.png": png_bytes(picture, dpi=120)},
        remarks=tuple(_describe(device) for device in devices),
    )


def _entry(one: StylusRun) -> dict[str, Any]:
    d, law = one.stylus.device, one.stylus.law
    return {
        "device": {
            "name": d.name,
            "mass_kg": d.mass_kg,
            "viscous_n_s_per_m": d.viscous_n_s_per_m,
            "dry_n": d.dry_n,
            "resolution_mm": d.resolution_mm,
            "rate_hz": d.rate_hz,
        },
        "law": {"delta_mm": law.delta_mm, "m": law.m, "cap_n": law.cap_n},
        "feed_forward_n": one.stylus.feed_forward.friction_n,
        "blend": one.stylus.blend,
        **one.summary(),
    }


def _table(runs: Sequence[StylusRun]) -> Rows:
    head = ("device, law, blend", "mean mm", "RMS", "p95", "max", "worst place", "slid mm", "force N")
    cells = ((_name(one.stylus), *(f"{v:.3f}" for v in one.summary().values())) for one in runs)
    return [head, *cells]


def _describe(d: SimulatedDevice) -> str:
    return (
        f"{d.name}: {1000 * d.mass_kg:g} g, dry friction {d.dry_n:g} N, viscous {d.viscous_n_s_per_m:g} "
        f"N·s/m, sensor step {d.resolution_mm:g} mm, {d.rate_hz:g} Hz"
    )


def _name(stylus: HeldStylus) -> str:
    law, added = stylus.law, stylus.feed_forward.friction_n
    extra = f" + {added:.3f} N with the surface" if added > 0.0 else ""
    return f"{stylus.device.name}, δ {law.delta_mm:.2f} mm m {law.m:g}{extra}, {stylus.blend}"


STUDY = Study(TrackingSettings, run, outputs=lambda _: ("tracking.json", "tracking.png"), trials=False)
