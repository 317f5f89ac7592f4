"""Cardiac MR as a hospital acquires it: a short-axis stack and long-axis cines, a breath-hold a slice."""

from dataclasses import asdict, dataclass, replace
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.motion import HeartMotion
from data_synth.heart.reference import ReferenceMap
from data_synth.heart.tissue import LABEL_NAMES
from dvf_ig.core import FloatArray, InvalidInputError, Preop, Rigid, Volume, VolumeSeries, read_only_arrays

from .stack import StackCine, StackProtocol, stack_cine, stack_grid

ExamName = Literal["sax7", "sax8", "sax10", "sax+lax"]
EXAMS: tuple[ExamName, ...] = get_args(ExamName)
PHASES = (20, 30)
"""Fewest and most phases of an examination."""
SLICES = (7, 12)
"""Fewest and most slices of a stack."""
SHIFT_MM = 2.0
"""Largest displacement of the heart in a breath-hold from its mean, so that two differ by 0 to 4 mm."""
RR_JITTER = 0.12
"""Largest relative deviation of a breath-hold's RR interval."""
BEYOND_APEX_MM, BELOW_BASE_MM = 4.0, 4.0
"""How far the stack begins beyond the epicardial apex, and ends below the mitral plane."""
FIELD_MM = 18.0
"""Margin of an image around the heart in its plane."""
LAX_THICKNESS_MM = 8.0
LAX_VIEWS = (("lax_4ch", 0.0), ("lax_2ch", 60.0), ("lax_3ch", 120.0))
"""Long-axis views: name, and angle about the long axis from the plane through both ventricles, degrees."""
THICKNESS_MM: dict[ExamName, float] = {"sax7": 8.0, "sax8": 8.0, "sax10": 10.0, "sax+lax": 8.0}
PIXEL_MM, PITCH_MM = 1.4, 10.0
"""Pixels, and distance from slice to slice: slices of 8 mm have gaps of 2 mm."""


@dataclass(frozen=True, slots=True)
class Scanner:
    """How slices are acquired; each attribute as in `StackProtocol`."""

    in_plane_mm: float
    psf_fwhm_mm: float
    bias: float
    snr: float
    breath_hold_mm: float
    rr_jitter: float


class ExaminedHeart(Protocol):
    """A heart before the intervention, frame "mr": `PhantomAnatomy` is one."""

    @property
    def mr_from_heart(self) -> Rigid:
        """Frame of its shapes, whose x axis points towards the right heart."""

    @property
    def resting_motion(self) -> HeartMotion:
        """Its motion."""

    @property
    def ed_vertices_mm(self) -> FloatArray:
        """(v, 3) epicardial surface at end-diastole."""

    @property
    def long_axis_mm(self) -> FloatArray:
        """(2, 3) epicardial apex of the left ventricle and middle of its base at end-diastole."""

    @property
    def rr_s(self) -> float:
        """RR interval for which its motion holds."""

    @property
    def es_fraction(self) -> float:
        """End-systole as a fraction of that."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """Images of an examination with their truth.

    Attributes:
        sax: the short-axis stack.
        lax: the long-axis cines in the order of LAX_VIEWS, each a stack of one slice; none without.
        base_mm: (phases,) true displacement of the middle of the mitral plane along the long axis towards
            the apex, at the phases of the stack, of the mean heart rate.
    """

    sax: StackCine
    lax: tuple[StackCine, ...]
    base_mm: FloatArray

    @property
    def views(self) -> tuple[VolumeSeries, ...]:
        """The long-axis cines."""
        return tuple(view.image for view in self.lax)

    def preop(self, patient_id: str, contours: NDArray[np.uint8] | None = None) -> Preop:
        """Data of the examination: cines, and the stack's labels at end-diastole.

        Args:
            contours: labels as an observer draws them; None: exact ones.
        """
        drawn = self.sax.labels.values[0] if contours is None else contours
        names = tuple((code, name) for code, name in LABEL_NAMES if (drawn == code).any())
        return Preop(
            patient_id=patient_id,
            mr=self.sax.image,
            ed_labels=Volume(self.sax.image.grid, drawn),
            label_names=names,
            organ_labels=tuple(code for code, _ in names),
            views=self.views,
        )

    def truth(self) -> dict[str, object]:
        """Shifts and RR intervals of all breath-holds, and the base's descent, as JSON."""
        return {
            "sax": _slices(self.sax),
            "lax": {name: _slices(view) for (name, _), view in zip(LAX_VIEWS, self.lax, strict=False)},
            "base_descent_mm": self.base_mm.tolist(),
        }


def examination(
    anatomy: ExaminedHeart,
    reference: ReferenceMap,
    name: ExamName,
    rng: np.random.Generator,
    phases: int | None = None,
    scanner: Scanner | None = None,
) -> Examination:
    """Examine a heart.

    Args:
        reference: its tissue and MR signal at end-diastole.
        name: "sax8" (8 mm slices, 2 mm gaps), "sax10" (10 mm, no gaps), "sax+lax" (as "sax8", with three
            long-axis cines), or "sax7" (as "sax8", the seven slices in the middle of the ventricles alone).
        rng: draws phases, breath-holds, heart rates, coil shading and noise.
        phases: number of them instead of the drawn one, to save time.
        scanner: pixels, point spread, shading and noise of its images, and its heart rates; None: usual ones.
    Raises:
        InvalidInputError: no such examination.
    """
    if name not in EXAMS:
        raise InvalidInputError(f"there is no examination '{name}'; choose from {', '.join(EXAMS)}")
    drawn_rng, stack_rng, *view_rngs = rng.spawn(2 + len(LAX_VIEWS))
    drawn = int(drawn_rng.integers(PHASES[0], PHASES[1] + 1))
    phases = drawn if phases is None else phases
    usual = StackProtocol(in_plane_mm=PIXEL_MM, breath_hold_mm=SHIFT_MM, rr_jitter=RR_JITTER)
    own = {} if scanner is None else asdict(scanner)
    protocol = replace(usual, phases=phases, pitch_mm=PITCH_MM, thickness_mm=THICKNESS_MM[name], **own)
    heart = _long_axis_frame(anatomy)
    sax = _stack(anatomy, reference, heart, protocol, name, stack_rng)
    views = LAX_VIEWS if name == "sax+lax" else ()
    of_view = replace(protocol, pitch_mm=LAX_THICKNESS_MM, thickness_mm=LAX_THICKNESS_MM)
    lax = [
        _view(anatomy, reference, heart, angle, of_view, r)
        for (_, angle), r in zip(views, view_rngs, strict=False)
    ]
    return Examination(sax, tuple(lax), _base_descent(anatomy, heart, phases))


def _long_axis_frame(anatomy: ExaminedHeart) -> Rigid:
    """Return mr_from_heart: origin at the epicardial apex, z to the base, x towards the right heart."""
    apex, base = anatomy.long_axis_mm
    z = (base - apex) / np.linalg.norm(base - apex)
    x = anatomy.mr_from_heart.rotation[:, 0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return Rigid("mr", "heart", np.column_stack([x, np.cross(z, x), z]), apex)


def _stack(
    anatomy: ExaminedHeart,
    reference: ReferenceMap,
    heart: Rigid,
    protocol: StackProtocol,
    name: ExamName,
    rng: np.random.Generator,
) -> StackCine:
    local = heart.inverse().apply_array(anatomy.ed_vertices_mm)
    low, high = local.min(axis=0) - FIELD_MM, local.max(axis=0) + FIELD_MM
    length = float(np.linalg.norm(np.diff(anatomy.long_axis_mm, axis=0)))
    count = int((length - BELOW_BASE_MM + BEYOND_APEX_MM) / protocol.pitch_mm) + 1
    count = SLICES[0] if name == "sax7" else min(max(count, SLICES[0]), SLICES[1])
    reach_mm = (count - 1) * protocol.pitch_mm
    low[2] = 0.5 * (length - reach_mm) if name == "sax7" else length - BELOW_BASE_MM - reach_mm
    size = np.array([*(high - low)[:2], reach_mm - 1e-6])
    grid = stack_grid(heart.rotation, heart.apply_array(low), size, protocol)
    timing = (anatomy.rr_s, anatomy.es_fraction)
    return stack_cine(reference, anatomy.resting_motion, grid, timing, rng, protocol)


def _view(
    anatomy: ExaminedHeart,
    reference: ReferenceMap,
    heart: Rigid,
    angle_deg: float,
    protocol: StackProtocol,
    rng: np.random.Generator,
) -> StackCine:
    """Acquire one slice that holds the long axis."""
    angle = np.deg2rad(angle_deg)
    across = heart.rotation @ np.array([np.cos(angle), np.sin(angle), 0.0])
    along = heart.rotation[:, 2]
    axes = np.column_stack([across, along, np.cross(across, along)])
    local = (anatomy.ed_vertices_mm - heart.translation_mm) @ axes
    low, high = local.min(axis=0) - FIELD_MM, local.max(axis=0) + FIELD_MM
    low[2] = high[2] = 0.0
    grid = stack_grid(axes, heart.translation_mm + axes @ low, high - low, protocol)
    timing = (anatomy.rr_s, anatomy.es_fraction)
    return stack_cine(reference, anatomy.resting_motion, grid, timing, rng, protocol)


def _base_descent(anatomy: ExaminedHeart, heart: Rigid, phases: int) -> FloatArray:
    base = anatomy.long_axis_mm[1:]
    z = heart.rotation[:, 2]
    moved = [anatomy.resting_motion.push_forward(base, i / phases) - base for i in range(phases)]
    return np.array([-float((step @ z)[0]) for step in moved])


def _slices(stack: StackCine) -> dict[str, object]:
    return {
        "rr_s": stack.slice_rr_s.tolist(),
        "shift_mm": stack.slice_shift_mm.tolist(),
        "trigger_s": stack.trigger_s.tolist(),
    }
