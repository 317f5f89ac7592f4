"""Ultrasound probes of the second world: epicardial, narrow-fanned, transoesophageal and intracardiac."""

from dataclasses import replace

import numpy as np

from data_synth.ultrasound.probe import SectorProbe

from .drawn import Drawn
from .ranges import KINDS

MARGIN_PX = 8.0


def probe_kind(drawn: Drawn) -> str:
    """Draw the kind of probe for this heart."""
    return drawn.choice("probe", KINDS)


def drawn_probe(drawn: Drawn) -> SectorProbe:
    """Draw the scanner's nominal geometry: depths of its images assume its own speed of sound."""
    return sector_of(probe_kind(drawn), drawn)


def sector_of(kind: str, drawn: Drawn) -> SectorProbe:
    """Draw a scanner of one kind."""
    depth, half = drawn[f"{kind}.depth_mm"], np.deg2rad(drawn[f"{kind}.half_angle_deg"])
    frequency, pixel = drawn[f"{kind}.frequency_mhz"], drawn["probe.mm_per_px"]
    columns = 2 * int(np.ceil(depth * np.sin(half) / pixel + MARGIN_PX))
    share = drawn[f"{kind}.tgc_muscle_share"]
    return SectorProbe(
        lines=round(2 * np.rad2deg(half) * drawn["probe.lines_per_deg"]),
        samples=8 * round(depth / 0.28 / 8),
        depth_mm=depth,
        half_angle_rad=float(half),
        frequency_mhz=frequency,
        bandwidth_mhz=frequency * drawn["probe.bandwidth_share"],
        aperture_mm=drawn[f"{kind}.aperture_mm"],
        focus_mm=depth * drawn["probe.focus_share"],
        depth_of_field_mm=0.5 * depth,
        rows=int(np.ceil(depth / pixel + 2 * MARGIN_PX)),
        columns=columns,
        mm_per_px=(pixel, pixel),
        apex_px=(0.5 * (columns - 1), MARGIN_PX),
        tgc_db_per_cm_mhz=share * drawn["muscle.attenuation"] + (1 - share) * drawn["blood.attenuation"],
        noise_db=drawn["image.noise_db"],
        dynamic_range_db=drawn["image.dynamic_range_db"],
        top_db=drawn["image.white_db"],
        specular_db=drawn["image.specular_db"],
        specular_power=drawn["image.specular_power"],
        elevation_aperture_mm=drawn["probe.slice_height_mm"],
        elevation_focus_mm=depth * drawn["probe.focus_share"],
        haze_db=drawn["image.haze_db"],
        haze_mm=drawn["image.haze_mm"],
        dirty_shadow_db=drawn["image.dirty_shadow_db"],
    )


def insonified(probe: SectorProbe, sound_speed: float) -> SectorProbe:
    """Scale a probe's depths to the true speed of sound, faster by `sound_speed` than assumed."""
    return replace(probe, depth_mm=probe.depth_mm * (1.0 + sound_speed))
