"""Picture of the blending study: error against the number of phases. Uses matplotlib."""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from dvf_ig.study.blending.blend_errors import BlendError, BlendStudy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"force": "#1f6fb4", "distance": "#e07b00", "periodic": "#2a8c4a"}
MARKS = {"force": "o", "distance": "s", "periodic": "^"}


def blending_png(studies: Sequence[BlendStudy]) -> bytes:
    """One row a motion: the blend's own share, surface felt, force; mean solid, 95th percentile dashed."""
    figure = Figure(figsize=(14.5, 4.3 * len(studies)), layout="constrained")
    panels = figure.subplots(len(studies), 3, squeeze=False)
    for (own, surface, force), study in zip(panels, studies, strict=True):
        _curves(own, study, "blend", "mm", 1.0)
        _curves(surface, study, "surface", "mm", 1.0)
        _curves(force, study, "force", "n", 1000.0)
        own.set(yscale="log", ylabel="blend against the spline of that instant, mm")
        own.set_title(f"{study.motion}: motion up to {study.largest_motion_mm:.1f} mm")
        surface.set(ylim=(0.0, None), ylabel="surface felt off the true one, mm")
        force.set(ylim=(0.0, None), ylabel="force error within 3 mm, mN (cap 600)")
    panels[0][2].legend(loc="center", fontsize=9, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def _curves(axes: "Axes", study: BlendStudy, quantity: str, unit: str, factor: float) -> None:
    for blend in dict.fromkeys(error.blend for error in study.errors):
        mine = [error for error in study.errors if error.blend == blend]
        for statistic, style in (("mean", "-"), ("p95", "--")):
            name = f"{quantity}_{statistic}_{unit}"
            known = [(error.phases, value) for error in mine if (value := _value(error, name)) is not None]
            axes.plot(
                [count for count, _ in known],
                [factor * value for _, value in known],
                style,
                color=COLORS[blend],
                marker=MARKS[blend],
                ms=5,
                label=f"{blend}, {statistic}",
            )
    floor = _value(study.at_phases, f"{quantity}_mean_{unit}")
    if floor is not None:
        axes.axhline(factor * floor, color="#888888", lw=1.0, ls=":", label="at the phases themselves, mean")
    counts = sorted({error.phases for error in study.errors})
    axes.set(xscale="log", xlabel="phases in the cycle")
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.xaxis.minorticks_off()
    axes.grid(alpha=0.3)


def _value(error: BlendError, name: str) -> float | None:
    value: float | None = getattr(error, name)
    return value
