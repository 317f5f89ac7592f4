"""The realism page: every measured figure with its bounds, every picture that was given."""

import io

import numpy as np

from data_synth.realism.gates import Gate
from scripts.realism_pictures import RealismPictures, bounds_text, realism_figure, realism_html

FIGURES = [
    Gate("smallest Jacobian", 0.3, 0.2, float("inf")),
    Gate("|det - 1|", 1e-3, 0.0, 1e-6),
    Gate("speckle < SNR", 1.9, 1.86, 1.96),
]


def test_a_missed_bound_shows() -> None:
    page = realism_html(FIGURES, b"png", "title")
    assert page.count("FAIL") == 1
    assert "≥ 0.2" in page
    assert "speckle &lt; SNR" in page


def test_bounds_are_an_interval_or_a_least_value() -> None:
    assert [bounds_text(f) for f in FIGURES] == ["≥ 0.2", "0 … 1e-06", "1.86 … 1.96"]


def test_the_figure_shows_statistics_and_every_view() -> None:
    depths = np.linspace(0.0, 150.0, 40)
    view = np.zeros((8, 8), dtype=np.uint8)
    shown = RealismPictures(
        np.random.default_rng(0).rayleigh(size=500),
        depths,
        150.0,
        np.full((24, 40), -40.0),
        {"fat": (3.0, 2.9), "liver": (0.0, np.nan)},
        {"lv_blood": (-depths, -depths)},
        {"paper5mm": ({"apical": view, "tee": view}, {"apical": view, "tee": view})},
    )
    figure = realism_figure(shown)
    titles = [axis.get_title() for axis in figure.get_axes()]
    assert titles.count("apical") == titles.count("tee") == 2
    assert titles[:4] == [
        "speckle in myocardium",
        "points at 40, 80, 120 mm (40 dB)",
        "echo re myocardium, dB",
        "power with depth, dB; dashed 2 alpha f",
    ]
    target = io.BytesIO()
    figure.savefig(target, format="png", dpi=20)
    assert target.getvalue()[:4] == b"\x89PNG"
