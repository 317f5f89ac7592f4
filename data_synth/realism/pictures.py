"""Pictures of the realism report: points, attenuation, hearts in standard views."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.beating_anatomy import BeatingAnatomy
from data_synth.heart.tissue import ACOUSTICS, Tissue
from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.views import VIEW_PROBE, VIEWS, standard_view
from dvf_ig.core import FloatArray, InvalidInputError

from .gates import CONTRASTS, DEPTHS_MM, PROBE, Gate, envelope, point_image
from .media import medium

_SHOWN_LINES = 12
_SHOWN_DB = 40.0


def points_db() -> FloatArray:
    """Simulate (lines, samples) three points, each relative to its peak, over the probe's middle lines."""
    total = np.sum([point_image(d) / point_image(d).max() for d in DEPTHS_MM], axis=0)
    middle = PROBE.lines // 2
    shown = total[middle - _SHOWN_LINES : middle + _SHOWN_LINES]
    return np.asarray(20 * np.log10(np.maximum(shown, 10 ** (-_SHOWN_DB / 20))))


def contrasts_db(gates: Iterable[Gate]) -> dict[str, tuple[float, float]]:
    """Compare echoes relative to myocardium: of the table, and as measured (NaN if not)."""
    measured = {g.name: g.value for g in gates}
    return {
        tissue.name.lower(): (
            ACOUSTICS[tissue].echo_db,
            measured.get(f"{tissue.name.lower()} re myocardium, dB", np.nan),
        )
        for tissue in CONTRASTS
    }


def attenuation_db() -> dict[str, tuple[FloatArray, FloatArray]]:
    """Compute power at each depth in two tissues: (samples,) as simulated, and by 2αf."""
    out = {}
    for tissue in (Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD):
        power = np.mean(envelope(medium(tissue, absorbing=True)) ** 2, axis=0)
        start = ACOUSTICS[tissue].echo_db
        line = start - 0.2 * ACOUSTICS[tissue].attenuation_db * PROBE.frequency_mhz * PROBE.depths_mm
        out[tissue.name.lower()] = (np.asarray(10 * np.log10(power)), line)
    return out


def heart_views(heart: BeatingAnatomy) -> tuple[dict[str, NDArray[np.uint8]], ...]:
    """Simulate the standard views, by view and probe: at end-diastole, then at end-systole."""
    return tuple(
        {f"{view} ({VIEW_PROBE[view]})": view_image(heart, view, phase) for view in VIEWS}
        for phase in (0.0, heart.es_fraction)
    )


def view_image(heart: BeatingAnatomy, view: str, phase: float) -> NDArray[np.uint8]:
    """Simulate a heart in a standard view with its usual probe."""
    probe = PROBES[VIEW_PROBE[view]]
    if not isinstance(probe, SectorProbe):
        raise InvalidInputError(f"view {view} needs a plane probe")
    pose = standard_view(view, heart.reference)
    return simulate_frame(heart, probe, pose, np.full(probe.lines, phase), seed=1, frame=0)
