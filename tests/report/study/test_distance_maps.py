"""The distance-map figure: slices of the maps that are named, bars of all."""

import numpy as np

from dvf_ig.report.study.distance_maps import SHOWN, distance_maps_figure, distance_maps_png
from dvf_ig.study.distance.maps import MapScore

EXACT = np.linspace(-20.0, 20.0, 12)[:, None, None] + np.zeros((12, 11, 10))


def score(name: str, off_mm: float) -> MapScore:
    return MapScore(name, 0.1, off_mm, off_mm, off_mm, 0.1, 2.0, 5.0, 3.0, 6.0, EXACT + off_mm)


def test_slices_show_the_error_near_the_surface() -> None:
    scores = [score(SHOWN[0], 0.5), score("another way", 1.0), score(SHOWN[4], 0.0)]
    figure = distance_maps_figure(scores, EXACT, "maps", within_mm=15.0)
    slices = [axis for axis in figure.axes if axis.images]
    assert [axis.get_title().splitlines()[0] for axis in slices] == [SHOWN[0], SHOWN[4]]
    shown = np.ma.filled(slices[0].images[0].get_array(), np.nan)
    near = np.abs(EXACT[:, :, 5].T) <= 15.0
    np.testing.assert_allclose(shown[near], 0.5)
    assert np.isnan(shown[~near]).all()
    bars = next(axis for axis in figure.axes if "fitted surface" in axis.get_xlabel())
    assert [patch.get_width() for patch in bars.patches] == [0.5, 1.0, 0.0]  # type: ignore[attr-defined]
    assert distance_maps_png(scores, EXACT, "maps", within_mm=15.0).startswith(b"\x89PNG")
