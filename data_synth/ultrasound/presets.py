"""Named probes, and the mounting of a side-fire catheter's array."""

import numpy as np

from dvf_ig.core import InvalidInputError

from .probe import SectorProbe
from .volume import MatrixProbe

PROBES: dict[str, SectorProbe | MatrixProbe] = {
    "epicardial": SectorProbe(),
    "apical": SectorProbe(
        lines=192,
        samples=768,
        fine_lines=8,
        depth_mm=160.0,
        half_angle_rad=float(np.deg2rad(37.5)),
        frequency_mhz=2.5,
        bandwidth_mhz=1.4,
        aperture_mm=20.0,
        rows=512,
        columns=512,
        mm_per_px=(0.38, 0.38),
        apex_px=(255.5, 40.0),
        specular_db=34.0,
        haze_db=-8.0,
    ),
    "tee": SectorProbe(
        lines=192,
        samples=768,
        fine_lines=8,
        depth_mm=140.0,
        half_angle_rad=float(np.deg2rad(45.0)),
        frequency_mhz=5.0,
        bandwidth_mhz=2.5,
        aperture_mm=11.0,
        focus_mm=70.0,
        rows=512,
        columns=512,
        mm_per_px=(0.39, 0.39),
        apex_px=(255.5, 60.0),
        tgc_db_per_cm_mhz=0.24,
        specular_db=34.0,
        elevation_aperture_mm=10.0,
    ),
    "curvilinear": SectorProbe(
        lines=192,
        samples=768,
        fine_lines=8,
        depth_mm=140.0,
        half_angle_rad=float(np.deg2rad(32.0)),
        frequency_mhz=3.5,
        bandwidth_mhz=2.0,
        aperture_mm=18.0,
        rows=512,
        columns=640,
        mm_per_px=(0.34, 0.34),
        apex_px=(319.5, -130.0),
        specular_db=34.0,
        face_radius_mm=50.0,
    ),
    "ice": SectorProbe(
        lines=128,
        samples=768,
        fine_lines=8,
        depth_mm=100.0,
        half_angle_rad=float(np.deg2rad(45.0)),
        frequency_mhz=7.0,
        bandwidth_mhz=3.5,
        aperture_mm=12.0,
        focus_mm=45.0,
        depth_of_field_mm=35.0,
        rows=512,
        columns=512,
        mm_per_px=(0.285, 0.285),
        apex_px=(255.5, 60.0),
        tgc_db_per_cm_mhz=0.2,
        specular_db=34.0,
        elevation_aperture_mm=2.5,
        elevation_focus_mm=40.0,
    ),
    "matrix": MatrixProbe(),
}
"""epicardial: phased, on the heart's surface (the scenarios' probe). apical: transthoracic, lower frequency,
near-field haze. tee: transoesophageal. curvilinear: curved array. ice: side-fire catheter. matrix: 3-D."""


def probe_named(name: str) -> SectorProbe | MatrixProbe:
    """Return the probe of a name.

    Raises:
        InvalidInputError: unknown name.
    """
    if name not in PROBES:
        raise InvalidInputError(f"there is no probe '{name}'; choose from {', '.join(PROBES)}")
    return PROBES[name]
