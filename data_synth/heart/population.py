"""Variation of hearts between people: sizes and pump function of each kind, and draws of them.

Sources: S. E. Petersen et al., JCMR 19:18, 2017 (volumes and ejection fractions of all chambers, UK Biobank);
N. Kawel et al., Circ. Cardiovasc. Imaging 5:500, 2012 (wall thickness: 5.3 ± 0.9 mm in women, 6.3 ± 1.1 mm in
men in the mean over the mid-cavity, 7 and 8 mm at its thickest); N. Kawel-Boehm et al., JCMR 22:87, 2020
(great vessels, atria); O. Bernard et al., IEEE TMI 37:2514, 2018 ("dilated": ejection fraction below 0.40,
more than 100 ml/m², wall below 12 mm; "hypertrophic": segments of 15 mm and more, normal ejection fraction).
The shares of POPULATION are chosen, as mostly sick hearts are operated on.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from data_synth.kernels import lv
from dvf_ig.core import FloatArray

from .heart_spec import HeartKind

POPULATION: tuple[tuple[HeartKind, float], ...] = (("healthy", 0.6), ("dilated", 0.2), ("hypertrophic", 0.2))
"""Shares of the kind "varied"."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Normal distribution truncated at both ends."""

    mean: float
    sd: float
    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        return float(np.clip(rng.normal(self.mean, self.sd), self.low, self.high))


@dataclass(frozen=True, slots=True)
class KindSpread:
    """Variation of one kind of heart.

    Attributes:
        lv_edv_ml: end-diastolic volume of the left ventricle.
        wall_mm: mean thickness of its wall half-way up at end-diastole.
        elongation: length over width of the left ventricle, relative to the standard heart.
        septal_excess_mm: thickness of the septum above that of the mean wall.
        rv_scale, la_scale, ra_scale: linear size relative to the left ventricle's epicardium, standard 1.
        ejection_fraction: ejection fraction of the left ventricle with the motion "physiological".
        twist: twist relative to the standard heart.
    """

    lv_edv_ml: Spread
    wall_mm: Spread
    elongation: Spread
    septal_excess_mm: Spread
    rv_scale: Spread
    la_scale: Spread
    ra_scale: Spread
    ejection_fraction: Spread
    twist: Spread


KINDS: dict[HeartKind, KindSpread] = {
    "healthy": KindSpread(
        lv_edv_ml=Spread(148.0, 30.0, 90.0, 215.0),
        wall_mm=Spread(7.6, 1.2, 5.5, 10.5),
        elongation=Spread(1.08, 0.06, 0.95, 1.22),
        septal_excess_mm=Spread(0.4, 0.6, -0.8, 1.6),
        rv_scale=Spread(1.0, 0.04, 0.9, 1.1),
        la_scale=Spread(0.8, 0.05, 0.7, 0.92),
        ra_scale=Spread(0.95, 0.06, 0.8, 1.1),
        ejection_fraction=Spread(0.60, 0.05, 0.50, 0.70),
        twist=Spread(1.0, 0.2, 0.5, 1.5),
    ),
    "dilated": KindSpread(
        lv_edv_ml=Spread(275.0, 30.0, 235.0, 330.0),
        wall_mm=Spread(7.6, 1.0, 6.0, 9.5),
        elongation=Spread(0.94, 0.05, 0.84, 1.04),
        septal_excess_mm=Spread(0.0, 0.5, -1.0, 1.0),
        rv_scale=Spread(0.9, 0.05, 0.8, 1.0),
        la_scale=Spread(0.77, 0.05, 0.67, 0.9),
        ra_scale=Spread(0.9, 0.07, 0.78, 1.05),
        ejection_fraction=Spread(0.27, 0.07, 0.13, 0.39),
        twist=Spread(0.6, 0.25, 0.1, 1.1),
    ),
    "hypertrophic": KindSpread(
        lv_edv_ml=Spread(122.0, 20.0, 85.0, 165.0),
        wall_mm=Spread(12.8, 1.0, 11.0, 15.0),
        elongation=Spread(1.06, 0.06, 0.94, 1.2),
        septal_excess_mm=Spread(4.5, 1.2, 2.5, 7.0),
        rv_scale=Spread(0.85, 0.04, 0.78, 0.95),
        la_scale=Spread(0.82, 0.05, 0.72, 0.95),
        ra_scale=Spread(0.88, 0.05, 0.78, 1.0),
        ejection_fraction=Spread(0.69, 0.03, 0.60, 0.74),
        twist=Spread(1.2, 0.2, 0.7, 1.6),
    ),
}

WALL_HEIGHT = 0.5 * lv.BASE
INNER_RANGE_MM = (9.0, 30.5)
ACTIVATION_RANGE = (0.05, 1.6)
LONGITUDINAL = Spread(1.0, 0.12, 0.75, 1.25)
"""Longitudinal shortening relative to the standard heart, at the same activation."""
HEART_RATE_BPM = Spread(68.0, 9.0, 50.0, 92.0)
SYSTOLE_S, SYSTOLE_S_PER_BPM = Spread(0.31, 0.015, 0.28, 0.34), 0.0015
"""Time from R peak to end-systole at 70 beats/min, and its shortening with the rate (Weissler 1968)."""


@dataclass(frozen=True, slots=True)
class LeftVentricle:
    """Size of the left ventricle at end-diastole.

    Attributes:
        inner_mm, apex_mm: radius at the base and height of the apex of the cavity in the standard heart.
        across, along: factors from the standard heart to the person's, across and along the long axis.
    """

    inner_mm: float
    apex_mm: float
    across: float
    along: float


def left_ventricle(edv_ml: float, wall_mm: float, elongation: float) -> LeftVentricle:
    """Size the left ventricle by volume, wall half-way up and elongation."""

    def sized(inner_mm: float) -> LeftVentricle:
        apex_mm = lv.CAVITY_APEX * (lv.OUTER - inner_mm) / (lv.OUTER - lv.INNER)
        apex_mm = float(np.clip(apex_mm, 5.0, 16.0))
        solid = np.pi * inner_mm**2 * (lv.BASE - apex_mm) * lv.POWER / (lv.POWER + 1.0)
        across = float((1e3 * edv_ml / (solid * elongation)) ** (1 / 3))
        return LeftVentricle(inner_mm, apex_mm, across, across * elongation)

    def excess(inner_mm: float) -> float:
        one = sized(inner_mm)
        outer, inner = lv.radii(WALL_HEIGHT, cavity_of(one))
        return float((outer - inner) * one.across - wall_mm)

    return sized(float(brentq(excess, *INNER_RANGE_MM, xtol=1e-6)))


def cavity_of(ventricle: LeftVentricle) -> FloatArray:
    """Build the (6,) `cavity` of `kernels.lv` that contracts as the standard one."""
    out = lv.STANDARD_CAVITY.copy()
    out[:2] = ventricle.inner_mm, ventricle.apex_mm
    return out


def ejection_fraction(cavity: FloatArray, level: float) -> float:
    """Compute the ejection fraction of the closed form at an activation."""
    z = np.linspace(cavity[1], lv.BASE, 400)
    inner = np.array([lv.radii(height, cavity)[1] for height in z])
    moved = z - level * cavity[2] * z**2 / lv.BASE
    rest = np.trapezoid(((1.0 - cavity[3] * level) * inner) ** 2, moved)
    return float(1.0 - rest / np.trapezoid(inner**2, z))


@dataclass(frozen=True, slots=True)
class PumpFunction:
    """Pump function of one heart.

    Attributes:
        contractility: factor on the activation.
        longitudinal, twist: shortening and twist relative to the standard heart.
        rr_s: RR interval of the pre-operative acquisition.
        es_fraction: end-systole as a fraction of it.
    """

    contractility: float
    longitudinal: float
    twist: float
    rr_s: float
    es_fraction: float

    def cavity(self, cavity: FloatArray) -> FloatArray:
        """Give a cavity this heart's contraction."""
        factors = np.array([1.0, 1.0, self.longitudinal, 1.0, self.twist, self.twist])
        return np.asarray(cavity * factors)


def draw_pump_function(kind: HeartKind, cavity: FloatArray, rng: np.random.Generator) -> PumpFunction:
    """Draw timing, twist, and the contractility that gives a drawn ejection fraction."""
    spread = KINDS[kind]
    target, longitudinal = spread.ejection_fraction.draw(rng), LONGITUDINAL.draw(rng)
    twist, rate_bpm = spread.twist.draw(rng), HEART_RATE_BPM.draw(rng)
    rr_s = 60.0 / rate_bpm
    systole_s = SYSTOLE_S.draw(rng) - SYSTOLE_S_PER_BPM * (rate_bpm - 70.0)
    start = PumpFunction(1.0, longitudinal, twist, rr_s, systole_s / rr_s).cavity(cavity)
    level = brentq(lambda a: ejection_fraction(start, a) - target, *ACTIVATION_RANGE, xtol=1e-6)
    return PumpFunction(float(level), longitudinal, twist, rr_s, systole_s / rr_s)


def draw_kind(kind: HeartKind, rng: np.random.Generator) -> HeartKind:
    """Return the kind itself, or draw one of POPULATION for "varied"; one number is drawn either way."""
    share = rng.uniform()
    if kind != "varied":
        return kind
    for name, portion in POPULATION:
        share -= portion
        if share < 0.0:
            return name
    return POPULATION[-1][0]
