"""Draw equations 10–11 of Ren 2008 over time: the force at a fixed point, as printed and corrected.

As printed, F = αF(Vᵢ) + (1−α)F(Vᵢ₊₁) with α = (t−tᵢ)/T_d gives the next volume's force at each volume's own
time and jumps at every volume; F = (1−α)F(Vᵢ) + αF(Vᵢ₊₁) is continuous. The paper has no such figure.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core import DvfModel, FloatArray, read_only_arrays
from dvf_ig.guidance import Evaluator, Law, static_force
from dvf_ig.preop import SplineField
from dvf_ig.report.style import ESTIMATE, TRUTH, WRONG, open_frame


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ForceOverTime:
    """Force of a fixture over time at a fixed point.

    Attributes:
        t_s: (n,) over one or more cycles, evenly spaced.
        volume_t_s: (k,) times of the volumes.
        distance_mm: (n,) positive inside.
        corrected_n, printed_n: (n,) force along the outward normal.
        rr_s: length of a cycle.
        phases: volumes in a cycle.
    """

    t_s: FloatArray
    volume_t_s: FloatArray
    distance_mm: FloatArray
    corrected_n: FloatArray
    printed_n: FloatArray
    rr_s: float
    phases: int


def force_over_time(
    model: DvfModel, point_mm: FloatArray, law: Law, *, cycles: int = 2, steps: int = 2000
) -> ForceOverTime:
    """Evaluate both forms.

    Args:
        model: fixture.
        point_mm: (3,) fixed point.
        law: force law.
        cycles: number of cycles; steps: samples per cycle.
    """
    phi = np.arange(cycles * steps) / steps
    samples = Evaluator(model, law).force(np.tile(point_mm, (len(phi), 1)), phi)
    outward = -samples.gradient / np.linalg.norm(samples.gradient, axis=1)[:, None]
    printed = _as_printed(model, point_mm, law, phi)
    volumes = (np.arange(cycles)[:, None] + model.timing.fractions).ravel()
    return ForceOverTime(
        t_s=phi * model.timing.rr_s,
        volume_t_s=volumes * model.timing.rr_s,
        distance_mm=samples.distance_mm,
        corrected_n=np.einsum("ij,ij->i", samples.force_n, outward),
        printed_n=np.einsum("ij,ij->i", printed, outward),
        rr_s=model.timing.rr_s,
        phases=model.phases,
    )


def over_time_figure(trace: ForceOverTime) -> Figure:
    """Draw the distance above and both forces below; a vertical line marks a volume."""
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.5))
    upper.plot(trace.t_s, trace.distance_mm, color=ESTIMATE, lw=2.0)
    upper.axhline(0.0, color=TRUTH, lw=0.8)
    upper.set(ylabel="distance, mm\n(inside > 0)")
    upper.set_title(f"{trace.phases} volumes per cycle of {trace.rr_s:g} s", fontsize=10)
    # breaks the line at each volume, at which the printed form jumps
    volume = np.searchsorted(trace.volume_t_s, trace.t_s + 1e-9, side="right")
    printed = np.where(np.diff(volume, prepend=volume[0]) != 0, np.nan, trace.printed_n)
    lower.plot(trace.t_s, printed, color=WRONG, lw=1.2, label="as printed: αF(Vᵢ) + (1−α)F(Vᵢ₊₁)")
    label = "corrected: (1−α)F(Vᵢ) + αF(Vᵢ₊₁)"
    lower.plot(trace.t_s, trace.corrected_n, color=ESTIMATE, lw=2.0, label=label)
    lower.set(xlabel="time, s", ylabel="outward force, N", xlim=(0.0, float(trace.t_s[-1])))
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    for axis in (upper, lower):
        for t_s in trace.volume_t_s:
            axis.axvline(t_s, color="#e9e9e9", lw=0.7, zorder=0)
    open_frame(upper, lower)
    figure.suptitle("Equations 10–11: a beating forbidden region, at a fixed point")
    return figure


def _as_printed(model: DvfModel, point_mm: FloatArray, law: Law, phi: FloatArray) -> FloatArray:
    """Evaluate eq. 10, (n, 3), with the weights as printed, α on the earlier volume."""
    forces = []
    for phase in range(model.phases):
        distance, gradient = SplineField.of_model(model, phase).at(point_mm[None])
        forces.append(static_force(law, distance, gradient)[0])
    out = np.empty((len(phi), 3))
    for k, at in enumerate(phi.tolist()):
        first, second, alpha = model.timing.bracket(at)
        out[k] = alpha * forces[first] + (1.0 - alpha) * forces[second]
    return out
