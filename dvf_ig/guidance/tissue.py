"""Softness, damping, friction and texture of tissues, and which of them a haptic device renders.

A mode for training and planning (Ren 2008, Section VIII): what is felt is by a table, not by the patient.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import DvfModel, InvalidInputError, Tissue, read_only_arrays
from dvf_ig.core.recordings.scenario import BLOOD_WORDS

from .device import MM_PER_M, DeviceLimits
from .fixtures import FixtureOptions, Fixtures, FixtureSet
from .laws import Gaussian

TIP_RADIUS_MM = 2.0
"""Radius a of the flat tip that the stiffnesses are for: k = 2 E a/(1 − ν²)."""
PRESS_MM = 2.0
"""Depth at which classes are compared."""
STIFFNESS_RATIO, FRICTION_RATIO = 1.5, 2.0
"""Smallest ratio of neighbouring stiffnesses that can be distinguished; of a friction to the device's own."""
STICK_SHARE = 0.5
"""Stiffness of sticking friction, as a share of what the device renders."""
FEEL_CAP_N = 0.6
ASSUMED = "assumed"


@dataclass(frozen=True, slots=True)
class TissueClass:
    """One kind of tissue, each value with its source.

    Attributes:
        name: for people; words: parts of the names of labels that are this tissue.
        stiffness_n_per_mm: k under the flat tip; damping_n_s_per_m: b.
        friction: coefficient μ; texture: share τ by which the normal force varies along the surface.
        sources: of these four, in this order.
    """

    name: str
    words: tuple[str, ...]
    stiffness_n_per_mm: float
    damping_n_s_per_m: float
    friction: float
    texture: float
    sources: tuple[str, str, str, str]

    @property
    def properties(self) -> tuple[tuple[str, str, str], ...]:
        """Name, value with unit, and source of each property, as text."""
        values = (
            ("stiffness", f"{self.stiffness_n_per_mm:.2g} N/mm"),
            ("damping", f"{self.damping_n_s_per_m:.2g} N·s/m"),
            ("friction", f"{self.friction:.2g}"),
            ("texture", f"{self.texture:.2g}"),
        )
        return tuple(
            (what, value, source) for (what, value), source in zip(values, self.sources, strict=True)
        )


def _stiffness(youngs_kpa: float) -> float:
    """Compute k in N/mm of tissue that keeps its volume (ν = ½), under the tip."""
    return 2.0 * 1e-3 * youngs_kpa * TIP_RADIUS_MM / (1.0 - 0.25)


LORING = "Loring 2005: serosa 0.03 to 0.08"
VILLEMAIN = "Villemain 2019: shear modulus 4.70 kPa at 40 to 59 years, in diastole; E three times that"
TISSUES: tuple[TissueClass, ...] = (
    TissueClass("fat", ("fat",), 0.008, 0.02, 0.1, 0.2, (ASSUMED,) * 4),
    TissueClass(
        "atrial wall",
        ("atri", "laa", "appendage"),
        0.02,
        0.04,
        0.05,
        0.0,
        (ASSUMED, ASSUMED, LORING, ASSUMED),
    ),
    TissueClass(
        "right ventricular wall",
        ("rv_wall", "rv_myo"),
        0.038,
        0.08,
        0.05,
        0.0,
        (ASSUMED, ASSUMED, LORING, ASSUMED),
    ),
    TissueClass(
        "myocardium",
        ("myo", "septum", "papillary", "lv_wall"),
        _stiffness(3.0 * 4.70),
        0.15,
        0.05,
        0.05,
        (VILLEMAIN, ASSUMED, LORING, ASSUMED),
    ),
    TissueClass(
        "great vessel", ("vessel", "aorta", "pulmonary", "vein"), 0.14, 0.2, 0.05, 0.0, (ASSUMED,) * 4
    ),
    TissueClass("scar", ("scar", "infarct"), 0.22, 0.3, 0.05, 0.1, (ASSUMED,) * 4),
    TissueClass(
        "liver",
        ("liver",),
        0.23,
        0.3,
        0.05,
        0.0,
        ("pig liver under an 8 mm ball, median", ASSUMED, LORING, ASSUMED),
    ),
    TissueClass("valve", ("valve", "annulus"), 0.3, 0.3, 0.05, 0.0, (ASSUMED,) * 4),
)
"""Kinds of tissue, softest first. A label is of the first kind that has a word of its name."""


def class_of(label: str) -> TissueClass | None:
    """Find the kind of tissue of a label by its name; None for blood and for names without a kind."""
    name = label.lower().replace(" ", "_")
    if any(word in name for word in BLOOD_WORDS):
        return None
    return next((one for one in TISSUES if any(word in name for word in one.words)), None)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Feel:
    """Tissue as a device renders it.

    Attributes:
        tissue: labels and motion.
        properties: (x, y, z, 4) float32 at the voxels of the labels: stiffness in N/mm, damping in N·s/mm,
            friction, texture; blood and background have those of the nearest tissue.
        stick_n_per_mm: stiffness of sticking friction.
        classes: kinds of tissue among the labels, softest first.
        refused: sentences on what the device cannot render, by name.
    """

    tissue: Tissue
    properties: NDArray[np.float32]
    stick_n_per_mm: float
    classes: tuple[TissueClass, ...]
    refused: tuple[str, ...]


def feel_of(model: DvfModel, device: DeviceLimits) -> Feel:
    """Prepare a model's tissue for a device.

    Raises:
        InvalidInputError: a model without tissue, or whose labels name none.
    """
    if model.tissue is None:
        raise InvalidInputError(
            f"the model of '{model.patient_id}' keeps no labels to feel; build it again from labels of every "
            "phase, or from a 4-D image with labels of end-diastole (dvf-ig model build)"
        )
    values = [value for value in np.unique(model.tissue.labels.values).tolist() if value != 0]
    of_label = {value: class_of(model.tissue.name(value)) for value in values}
    classes = tuple(one for one in TISSUES if one in of_label.values())
    if not classes:
        names = ", ".join(model.tissue.name(value) for value in values)
        raise InvalidInputError(
            f"no label of the model is named as a tissue ({names}); name them (label_names), for example "
            f"{', '.join(one.words[0] for one in TISSUES)}"
        )
    table, refused = np.zeros((256, 4)), _refused_stiffness(classes, device)
    rendered = {one: _rendered(one, device, refused) for one in classes}
    for value, one in of_label.items():
        if one is not None:
            table[value] = rendered[one]
    labels = model.tissue.labels.values
    nearest = ndimage.distance_transform_edt(
        table[labels, 0] == 0.0, return_distances=False, return_indices=True
    )
    properties = table[labels[tuple(nearest)]].astype(np.float32)
    stick = STICK_SHARE * device.allowed_stiffness_n_per_mm
    return Feel(model.tissue, properties, stick, classes, tuple(refused))


def _refused_stiffness(classes: tuple[TissueClass, ...], device: DeviceLimits) -> list[str]:
    """Name classes that are too stiff for the device, or whose stiffness is too near that of the next."""
    name, allowed = device.name or "device", device.allowed_stiffness_n_per_mm
    out = [
        f"the {name} renders {one.name} with {allowed:.2g} instead of {one.stiffness_n_per_mm:.2g} N/mm"
        for one in classes
        if one.stiffness_n_per_mm > allowed
    ]
    for soft, stiff in pairwise(classes):
        ratio = min(stiff.stiffness_n_per_mm, allowed) / min(soft.stiffness_n_per_mm, allowed)
        if ratio < STIFFNESS_RATIO:
            out.append(
                f"{stiff.name} cannot be distinguished from {soft.name} by stiffness on the {name}: "
                f"{ratio:.2f} times as stiff, needed {STIFFNESS_RATIO:g}"
            )
    return out


def _rendered(one: TissueClass, device: DeviceLimits, refused: list[str]) -> tuple[float, ...]:
    """Return k, b, μ and τ that the device renders; adds a sentence on those that its own friction hides."""
    stiffness = min(one.stiffness_n_per_mm, device.allowed_stiffness_n_per_mm)
    press_n, hidden_n = stiffness * PRESS_MM, FRICTION_RATIO * device.friction_n
    shares = []
    for what, share in (("friction", one.friction), ("texture", one.texture)):
        size_n = share * press_n
        shares.append(share if size_n >= hidden_n else 0.0)
        if 0.0 < size_n < hidden_n:
            refused.append(
                f"the {what} of {one.name} cannot be rendered on the {device.name or 'device'}: "
                f"{size_n:.2g} N at {PRESS_MM:g} mm, its own friction is {device.friction_n:.2g} N"
            )
    return stiffness, one.damping_n_s_per_m / MM_PER_M, *shares


def feel_fixtures(model: DvfModel, device: DeviceLimits) -> Fixtures:
    """Bind the surface that is touched; its guidance gives way to tissue, its cap holds."""
    cap_n = min(FEEL_CAP_N, device.continuous_force_n)
    surface = FixtureOptions(Gaussian(delta_mm=10.0, cap_n=cap_n), name="tissue")
    return Fixtures(model, FixtureSet((surface,), device=device))
