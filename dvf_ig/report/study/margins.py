"""Figure of margins: violation depth against the room that a margin takes, fixed and adaptive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from matplotlib.figure import Figure

from dvf_ig.report.style import ESTIMATE, GUIDE, START, open_frame, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Estimate(Protocol):
    """A value with its interval."""

    @property
    def value(self) -> float | None: ...
    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...


class Violation(Protocol):
    """Violation depth over hearts."""

    @property
    def p95_mm(self) -> Estimate: ...
    @property
    def mean_mm(self) -> Estimate: ...


class AtWidth(Protocol):
    """Both margins of one mean width."""

    @property
    def widening_mm(self) -> float: ...
    @property
    def fixed(self) -> Violation: ...
    @property
    def adaptive(self) -> Violation: ...


class Margins(Protocol):
    """All widths, and no margin."""

    @property
    def hearts(self) -> int: ...
    @property
    def off(self) -> Violation: ...
    @property
    def widths(self) -> Sequence[AtWidth]: ...


def margins_figure(found: Margins) -> Figure:
    """Left the 95th percentile over hearts, right the mean, each against the mean widening."""
    figure = Figure(figsize=(9.5, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw(left, found, [v.p95_mm for v in _violations(found, "fixed")], "fixed", START)
    _draw(left, found, [v.p95_mm for v in _violations(found, "adaptive")], "adaptive", ESTIMATE)
    _draw(right, found, [v.mean_mm for v in _violations(found, "fixed")], "fixed", START)
    _draw(right, found, [v.mean_mm for v in _violations(found, "adaptive")], "adaptive", ESTIMATE)
    for axis, title in ((left, "95th percentile over hearts"), (right, "mean over hearts")):
        axis.set(title=title, xlabel="mean widening, mm")
        axis.title.set_fontsize(10)
        axis.set_ylim(bottom=0.0)
        axis.axvline(0.0, color=GUIDE, lw=0.8)
        open_frame(axis)
    left.set_ylabel("violation depth of a heart\n(p95 over places and times), mm")
    right.legend(frameon=False)
    figure.suptitle(f"Walls inside the true surface at equal free workspace, {found.hearts} simulated hearts")
    return figure


def margins_png(found: Margins) -> bytes:
    """`margins_figure` as a PNG file's bytes."""
    return png_bytes(margins_figure(found), dpi=120)


def _violations(found: Margins, mode: str) -> list[Violation]:
    return [found.off, *(getattr(width, mode) for width in found.widths)]


def _draw(axis: Axes, found: Margins, depths: Sequence[Estimate], label: str, color: str) -> None:
    at = [0.0, *(width.widening_mm for width in found.widths)]
    values = [0.0 if depth.value is None else depth.value for depth in depths]
    axis.plot(at, values, "o-", color=color, label=label, clip_on=False)
    if all(depth.low is not None and depth.high is not None for depth in depths):
        low = [depth.low or 0.0 for depth in depths]
        high = [depth.high or 0.0 for depth in depths]
        axis.fill_between(at, low, high, color=color, alpha=0.15, lw=0)
