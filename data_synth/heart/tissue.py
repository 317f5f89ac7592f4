"""Tissues of the synthetic thorax: codes, names, and their appearance in MR and ultrasound."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class Tissue(IntEnum):
    """Codes stored in tissue maps. 1–15 lie inside the epicardial surface, 20 and above outside."""

    MEDIASTINUM = 0
    LV_MYOCARDIUM = 1
    LV_BLOOD = 2
    RV_WALL = 3
    RV_BLOOD = 4
    ATRIAL_WALL = 5
    LA_BLOOD = 6
    RA_BLOOD = 7
    LAA_BLOOD = 8
    VESSEL_WALL = 9
    AORTA = 10
    PULMONARY_ARTERY = 11
    VALVE = 12
    PAPILLARY = 13
    LUNG = 20
    LIVER = 21
    BONE = 22
    FAT = 23
    PERICARDIUM = 24


FIRST_OUTSIDE = 20
"""Codes below this one (and not MEDIASTINUM) belong to the heart."""

BLOOD = (
    Tissue.LV_BLOOD,
    Tissue.RV_BLOOD,
    Tissue.LA_BLOOD,
    Tissue.RA_BLOOD,
    Tissue.LAA_BLOOD,
    Tissue.AORTA,
    Tissue.PULMONARY_ARTERY,
)


MUSCLE = (Tissue.LV_MYOCARDIUM, Tissue.RV_WALL, Tissue.ATRIAL_WALL)
"""Tissues whose fibres lie in the plane of the wall."""

ANISOTROPY_DB = 12.0
"""Loss of a beam along a wall compared with one that meets it at a right angle, dB.

Myofibres return least along themselves, by 14.5 dB in fixed human muscle (Hoffmeister 1995); they turn
through the thickness of a wall, so the average loss is smaller. Walls drop out where they are parallel to the
beam for this reason (Aygen and Popp 1987).
"""


@dataclass(frozen=True, slots=True)
class Acoustics:
    """Ultrasound properties of one tissue.

    Attributes:
        impedance_mrayl: acoustic impedance Z.
        attenuation_db: α in dB/cm/MHz, one way.
        echo_db: backscatter amplitude relative to myocardium.
    """

    impedance_mrayl: float
    attenuation_db: float
    echo_db: float


@dataclass(frozen=True, slots=True)
class Relaxation:
    """MR properties of one tissue: T1 and T2 in ms, proton density, inflow factor."""

    t1_ms: float
    t2_ms: float
    density: float
    inflow: float = 1.0


_MUSCLE = Acoustics(1.68, 0.52, 0.0)
_BLOOD = Acoustics(1.61, 0.15, -27.0)
_MUSCLE_MR = Relaxation(900, 50, 80)
_BLOOD_MR = Relaxation(1200, 100, 95, 1.9)

ACOUSTICS: dict[Tissue, Acoustics] = {
    **dict.fromkeys(Tissue, _MUSCLE),
    **dict.fromkeys(BLOOD, _BLOOD),
    Tissue.MEDIASTINUM: Acoustics(1.60, 0.30, -12.0),
    Tissue.VALVE: Acoustics(1.75, 1.57, 8.0),
    Tissue.PERICARDIUM: Acoustics(1.75, 1.57, 8.0),
    Tissue.FAT: Acoustics(1.38, 0.63, 3.0),
    Tissue.LIVER: Acoustics(1.65, 0.60, 0.0),
    Tissue.LUNG: Acoustics(0.0004, 40.0, 0.0),
    Tissue.BONE: Acoustics(7.8, 10.0, 6.0),
}
"""MR properties of the synthetic world. MEDIASTINUM is the loose tissue and coupling fluid around the
heart."""

RELAXATION: dict[Tissue, Relaxation] = {
    **dict.fromkeys(Tissue, _MUSCLE_MR),
    **dict.fromkeys(BLOOD, _BLOOD_MR),
    Tissue.MEDIASTINUM: Relaxation(550, 52, 60),
    Tissue.VALVE: _BLOOD_MR,
    Tissue.PAPILLARY: _BLOOD_MR,
    Tissue.PERICARDIUM: Relaxation(1000, 30, 25),
    Tissue.FAT: Relaxation(350, 58, 70),
    Tissue.LIVER: Relaxation(800, 50, 90),
    Tissue.LUNG: Relaxation(1200, 30, 12),
    Tissue.BONE: Relaxation(1000, 20, 15),
}
"""Valves and papillary muscles are absent from MR: they look like the blood around them."""

LABEL_NAMES: tuple[tuple[int, str], ...] = tuple(
    (int(code), code.name.lower())
    for code in Tissue
    if 0 < code < FIRST_OUTSIDE and code not in (Tissue.VALVE, Tissue.PAPILLARY)
)
"""Labels of the pre-operative segmentation, all inside the epicardial surface."""


FLIP_RAD, ECHO_TIME_MS = np.pi / 3, 1.5


def bssfp_signal(tissue: Tissue) -> float:
    """Compute ρ sinα e^(−TE/T2) / [(T1/T2 + 1) − cosα (T1/T2 − 1)], times the inflow factor."""
    r = RELAXATION[tissue]
    ratio = r.t1_ms / r.t2_ms
    level = r.density * np.sin(FLIP_RAD) * np.exp(-ECHO_TIME_MS / r.t2_ms)
    return float(r.inflow * level / ((ratio + 1) - np.cos(FLIP_RAD) * (ratio - 1)))
