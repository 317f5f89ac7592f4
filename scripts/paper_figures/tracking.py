"""Draw errors of tracking the beating surface: Ren 2008, Figs 14 (automatic) and 15 (manual)."""

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core import FloatArray
from dvf_ig.report.style import ESTIMATE, GUIDE, TRUTH, open_frame

BINS = 40


def tracking_errors_figure(t_s: FloatArray, error_mm: FloatArray, title: str, paper_mm: float) -> Figure:
    """Draw (a) the histogram of |error| and (b) the error over time.

    Args:
        t_s, error_mm: (n,) signed distance to the true surface, positive inside.
        paper_mm: mean error in the paper.
    """
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.7))
    size = np.abs(error_mm)
    mean = float(size.mean())
    left.hist(size, bins=BINS, color=ESTIMATE, weights=np.full(len(size), 100.0 / len(size)))
    left.axvline(mean, color=TRUTH, lw=1.4, label=f"mean here {mean:.2f} mm")
    left.axvline(paper_mm, color=GUIDE, lw=1.4, ls="--", label=f"mean in Ren 2008 {paper_mm:.2f} mm")
    left.set(xlabel="|error|, mm", ylabel="share of the time, %", title="(a)", xlim=(0.0, None))
    left.legend(frameon=False, fontsize=9)
    right.plot(t_s, error_mm, color=ESTIMATE, lw=0.6)
    right.axhline(0.0, color=TRUTH, lw=0.8)
    right.set(xlabel="time, s", ylabel="error, mm (inside > 0)", title="(b)")
    right.margins(x=0.0)
    open_frame(left, right)
    figure.suptitle(title, fontsize=11)
    return figure
