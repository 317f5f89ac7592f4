"""Ultrasound and MR properties of each tissue, drawn for one heart of the second world."""

import numpy as np

from data_synth.heart.tissue import Tissue
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray

from .drawn import Drawn

EFFUSION = 40
"""Code of pericardial fluid, in addition to those of `Tissue`."""
TRABECULA = 41
"""Code of the properties of trabeculae; labels call them blood."""
CODES = 42

LN_IMPEDANCE, ATTENUATION, ECHO, BLOOD_ECHO, SIGNAL = range(5)
"""Columns of the table."""

BLOODS = (
    Tissue.LV_BLOOD,
    Tissue.RV_BLOOD,
    Tissue.LA_BLOOD,
    Tissue.RA_BLOOD,
    Tissue.LAA_BLOOD,
    Tissue.AORTA,
    Tissue.PULMONARY_ARTERY,
)
MUSCLES = (Tissue.LV_MYOCARDIUM, Tissue.RV_WALL, Tissue.ATRIAL_WALL)

_KINDS: dict[int, tuple[str, str]] = {
    **{int(blood): ("blood", "blood") for blood in BLOODS},
    Tissue.LV_MYOCARDIUM: ("muscle", "muscle"),
    Tissue.RV_WALL: ("muscle", "muscle"),
    Tissue.PAPILLARY: ("muscle", "muscle"),
    TRABECULA: ("muscle", "muscle"),
    Tissue.ATRIAL_WALL: ("atrium", "wall"),
    Tissue.VESSEL_WALL: ("vessel", "wall"),
    Tissue.VALVE: ("valve", "wall"),
    Tissue.PERICARDIUM: ("pericardium", "wall"),
    Tissue.MEDIASTINUM: ("mediastinum", "mediastinum"),
    Tissue.FAT: ("fat", "fat"),
    Tissue.LIVER: ("liver", "liver"),
    Tissue.LUNG: ("lung", "lung"),
    Tissue.BONE: ("bone", "bone"),
    EFFUSION: ("effusion", "fluid"),
}
"""Rows of the table of ranges for each code: of acoustics, and of relaxation."""


def property_table(drawn: Drawn) -> FloatArray:
    """Build (CODES, 5) ln Z, attenuation, echo amplitude of tissue and of blood, and MR signal."""
    table = np.zeros((CODES, 5))
    sequence = _Sequence(drawn)
    for code, (acoustic, relaxation) in _KINDS.items():
        amplitude = 10 ** (drawn[f"{acoustic}.echo_db"] / 20)
        fluid = acoustic in ("blood", "effusion")
        table[code, LN_IMPEDANCE] = np.log(drawn[f"{acoustic}.impedance"])
        table[code, ATTENUATION] = drawn[f"{acoustic}.attenuation"]
        table[code, BLOOD_ECHO if fluid else ECHO] = amplitude
        table[code, SIGNAL] = sequence.signal(relaxation, code)
    return table


class _Sequence:
    """Steady-state signal of one cine sequence, in thousandths of the full magnetisation."""

    def __init__(self, drawn: Drawn) -> None:
        self.drawn = drawn
        self.balanced = drawn["mr.balanced"] >= 0.5
        name = "balanced" if self.balanced else "spoiled"
        self.flip = np.deg2rad(drawn[f"mr.{name}_flip_deg"])
        self.tr_s = drawn[f"mr.{name}_tr_s"]
        rng = child_rng(drawn.seed, "second world inflow")
        self.inflow = drawn["mr.inflow"] * (1 + drawn["mr.inflow_variation"] * rng.uniform(-1, 1, CODES))

    def signal(self, kind: str, code: int) -> float:
        """Compute the signal of a tissue; blood that flows in brings fresh magnetisation.

        Balanced: M sin α (1 − E₁)/(1 − (E₁ − E₂) cos α − E₁E₂) √E₂. Spoiled: M sin α (1 − E₁)/(1 − E₁ cos α).
        Source: Bernstein, King, Zhou, Handbook of MRI Pulse Sequences, 2004, sections 14.1.
        """
        d = self.drawn
        density = d[f"mr.{kind}_density"]
        e1, e2 = np.exp(-self.tr_s / d[f"mr.{kind}_t1"]), np.exp(-self.tr_s / d[f"mr.{kind}_t2"])
        sine, cosine = np.sin(self.flip), np.cos(self.flip)
        if self.balanced:
            steady = sine * (1 - e1) / (1 - (e1 - e2) * cosine - e1 * e2) * np.sqrt(e2)
        else:
            steady = sine * (1 - e1) / (1 - e1 * cosine)
        share = self.inflow[code] if kind == "blood" else 0.0
        return float(1000.0 * density * ((1 - share) * steady + share * sine))
