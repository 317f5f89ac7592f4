"""Figure of the blending study: error of a blend between phases against the number of phases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from matplotlib.figure import Figure

from dvf_ig.report.style import ESTIMATE, GUIDE, SERIES, START, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"force": ESTIMATE, "distance": START, "periodic": SERIES[2]}
MARKS = {"force": "o", "distance": "s", "periodic": "^"}


class BlendError(Protocol):
    """Errors of one blend at one number of phases; the blend's own share is None where it has none."""

    @property
    def blend(self) -> str: ...
    @property
    def phases(self) -> int: ...
    @property
    def surface_mean_mm(self) -> float: ...
    @property
    def surface_p95_mm(self) -> float: ...
    @property
    def force_mean_n(self) -> float: ...
    @property
    def force_p95_n(self) -> float: ...
    @property
    def blend_mean_mm(self) -> float | None: ...
    @property
    def blend_p95_mm(self) -> float | None: ...


class BlendStudy(Protocol):
    """All errors of one motion, and those at the phases themselves."""

    @property
    def motion(self) -> str: ...
    @property
    def errors(self) -> Sequence[BlendError]: ...
    @property
    def at_phases(self) -> BlendError: ...
    @property
    def largest_motion_mm(self) -> float: ...


Value = Callable[[BlendError], float | None]


def blending_png(studies: Sequence[BlendStudy]) -> bytes:
    """The figure as a PNG file's bytes."""
    return png_bytes(blending_figure(studies), dpi=100)


def blending_figure(studies: Sequence[BlendStudy]) -> Figure:
    """One row a motion: the blend's own share, rendered surface, force; mean solid, p95 dashed."""
    figure = Figure(figsize=(14.5, 4.3 * len(studies)), layout="constrained")
    panels = figure.subplots(len(studies), 3, squeeze=False)
    for (own, surface, force), study in zip(panels, studies, strict=True):
        _curves(own, study, lambda e: e.blend_mean_mm, lambda e: e.blend_p95_mm)
        _curves(surface, study, lambda e: e.surface_mean_mm, lambda e: e.surface_p95_mm)
        _curves(force, study, lambda e: 1000.0 * e.force_mean_n, lambda e: 1000.0 * e.force_p95_n)
        own.set(yscale="log", ylabel="blend against the spline of that instant, mm")
        own.set_title(f"{study.motion}: motion up to {study.largest_motion_mm:.1f} mm")
        surface.set(ylim=(0.0, None), ylabel="distance from the true surface to the rendered one, mm")
        force.set(ylim=(0.0, None), ylabel="force error within 3 mm, mN (largest force 600)")
    panels[0][2].legend(loc="best", fontsize=9, frameon=False)
    return figure


def _curves(axes: Axes, study: BlendStudy, mean: Value, p95: Value) -> None:
    for blend in dict.fromkeys(error.blend for error in study.errors):
        mine = [error for error in study.errors if error.blend == blend]
        for statistic, value_of, style in (("mean", mean, "-"), ("p95", p95, "--")):
            known = [(error.phases, value) for error in mine if (value := value_of(error)) is not None]
            axes.plot(
                [count for count, _ in known],
                [value for _, value in known],
                style,
                color=COLORS[blend],
                marker=MARKS[blend],
                ms=5,
                label=f"{blend}, {statistic}",
            )
    floor = mean(study.at_phases)
    if floor is not None:
        axes.axhline(floor, color=GUIDE, lw=1.0, ls=":", label="at the phases themselves, mean")
    counts = sorted({error.phases for error in study.errors})
    axes.set(xscale="log", xlabel="phases in the cycle")
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.xaxis.minorticks_off()
    axes.grid(alpha=0.3)
