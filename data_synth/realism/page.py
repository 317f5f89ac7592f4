"""One page of pictures and figures: how real the synthetic ultrasound is."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rayleigh

from data_synth.heart.anatomy import BeatingAnatomy
from data_synth.heart.tissue import ACOUSTICS, Tissue
from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.views import VIEW_PROBE, VIEWS, standard_view
from dvf_ig.core import FloatArray, InvalidInputError

from .gates import CONTRASTS, DEPTHS_MM, PROBE, Gate, envelope, point_image
from .media import medium

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def realism_figure(
    envelopes: FloatArray, gates: Iterable[Gate], hearts: Mapping[str, BeatingAnatomy]
) -> Figure:
    """The pictures: statistics above, and each heart in the standard views at its two ends below.

    Args:
        envelopes: of homogeneous myocardium, see `realism.homogeneous`.
        gates: everything measured; the contrasts are drawn.
        hearts: by name of their motion.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 4.0 + 6.4 * len(hearts)), layout="constrained")
    parts = figure.subfigures(1 + len(hearts), 1, squeeze=False, height_ratios=[4.0, *[6.4] * len(hearts)])
    upper = parts[0, 0].subplots(1, 4)
    _draw_histogram(upper[0], envelopes)
    _draw_points(upper[1])
    _draw_contrast(upper[2], gates)
    _draw_attenuation(upper[3])
    for part, (motion, heart) in zip(parts[1:, 0], hearts.items(), strict=True):
        part.suptitle(f"{motion}: end-diastole above, end-systole below")
        axes = part.subplots(2, len(VIEWS))
        for row, phase in zip(axes, (0.0, heart.es_fraction), strict=True):
            for axis, view in zip(row, VIEWS, strict=True):
                axis.imshow(view_image(heart, view, phase), cmap="gray", vmin=0, vmax=255)
                axis.set_title(f"{view} ({VIEW_PROBE[view]})", fontsize=8)
                axis.axis("off")
    return figure


def view_image(heart: BeatingAnatomy, view: str, phase: float) -> NDArray[np.uint8]:
    """A heart in a standard view, by the probe it is taken with."""
    probe = PROBES[VIEW_PROBE[view]]
    if not isinstance(probe, SectorProbe):
        raise InvalidInputError(f"view {view} needs a plane probe")
    pose = standard_view(view, heart.reference)
    return simulate_frame(heart, probe, pose, np.full(probe.lines, phase), seed=1, frame=0)


def realism_html(gates: Iterable[Gate], picture_png: bytes, title: str) -> str:
    """A page that needs nothing but itself."""
    rows = "".join(
        f"<tr class='{'ok' if g.passed else 'no'}'><td>{html.escape(g.name)}</td><td>{g.value:.4g}</td>"
        f"<td>{bounds(g)}</td><td>{'pass' if g.passed else 'FAIL'}</td></tr>"
        for g in gates
    )
    picture = base64.b64encode(picture_png).decode()
    return (
        f"<!doctype html><meta charset='utf-8'><title>{html.escape(title)}</title>"
        "<style>body{font:14px sans-serif;margin:2em;max-width:1400px}td,th{padding:2px 12px;text-align:left}"
        "tr.no td{background:#fdd}td:nth-child(2),td:nth-child(3){text-align:right}img{width:100%}</style>"
        f"<h1>{html.escape(title)}</h1><img alt='pictures' src='data:image/png;base64,{picture}'>"
        f"<table><tr><th>gate</th><th>value</th><th>bounds</th><th></th></tr>{rows}</table>\n"
    )


def bounds(gate: Gate) -> str:
    """The interval as text."""
    if np.isinf(gate.high):
        return f"≥ {gate.low:.4g}"
    return f"{gate.low:.4g} … {gate.high:.4g}"


def _draw_histogram(axis: Axes, envelopes: FloatArray) -> None:
    scale = float(np.sqrt((envelopes**2).mean() / 2))
    levels = np.linspace(0, 4.5 * scale, 200)
    axis.hist(envelopes.ravel(), bins=80, range=(0, 4.5 * scale), density=True, color="#9bb8d3")
    axis.plot(levels, rayleigh.pdf(levels, scale=scale), "k", lw=1, label="Rayleigh")
    axis.set_title("speckle in myocardium", fontsize=9)
    axis.set_xlabel("envelope, re myocardium")
    axis.legend(fontsize=8)


def _draw_points(axis: Axes) -> None:
    total = np.sum([point_image(d) / point_image(d).max() for d in DEPTHS_MM], axis=0)
    middle = PROBE.lines // 2
    shown = 20 * np.log10(np.maximum(total[middle - 12 : middle + 12], 1e-2))
    extent = (0.0, PROBE.depth_mm, -12.0, 12.0)
    axis.imshow(shown, aspect="auto", extent=extent, cmap="gray", interpolation="nearest")
    axis.set_title("points at 40, 80, 120 mm (40 dB)", fontsize=9)
    axis.set_xlabel("depth, mm")
    axis.set_ylabel("scan line from the middle")


def _draw_contrast(axis: Axes, gates: Iterable[Gate]) -> None:
    measured = {g.name: g.value for g in gates}
    names = [t.name.lower() for t in CONTRASTS]
    values = [measured.get(f"{name} re myocardium, dB", np.nan) for name in names]
    place = np.arange(len(names))
    axis.bar(place - 0.2, [ACOUSTICS[t].echo_db for t in CONTRASTS], 0.4, label="table", color="#cccccc")
    axis.bar(place + 0.2, values, 0.4, label="measured", color="#9bb8d3")
    axis.set_xticks(place, names, rotation=20, fontsize=8)
    axis.set_title("echo re myocardium, dB", fontsize=9)
    axis.legend(fontsize=8)


def _draw_attenuation(axis: Axes) -> None:
    for tissue in (Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD):
        power = np.mean(envelope(medium(tissue, absorbing=True)) ** 2, axis=0)
        start = ACOUSTICS[tissue].echo_db
        line = start - 0.2 * ACOUSTICS[tissue].attenuation_db * PROBE.frequency_mhz * PROBE.depths_mm
        axis.plot(PROBE.depths_mm, 10 * np.log10(power), lw=0.7, label=tissue.name.lower())
        axis.plot(PROBE.depths_mm, line, "k--", lw=1)
    axis.set_title("power with depth, dB; dashed 2 alpha f", fontsize=9)
    axis.set_xlabel("depth, mm")
    axis.legend(fontsize=8)
