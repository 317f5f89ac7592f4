"""Non-rigid difference between the imaged heart and the heart during the intervention."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from data_synth.kernels.interpolation import cubic_at
from data_synth.kernels.waves import wave_sum
from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays

CORRELATION_MM = 30.0
MODES = 48
TABLE_MM = 5.0
RETRACTED_OVER_MM = 25.0
LOAD_CENTER_MM = 20.0
"""Distance from the heart's centre up to which a volume load grows."""
FREE_WALL = np.array([0.95, -0.3, 0.0])
"""Side of the heart where a retractor presses, LPS: left, slightly to the front."""
_FIT_CELLS = 16


@dataclass(frozen=True, slots=True)
class SurgicalChange:
    """Change of the heart's shape by surgery, in addition to a random smooth difference.

    Attributes:
        retraction_mm: how far a retractor presses the free wall in, falling off over RETRACTED_OVER_MM.
        load_mm: how far filling moves all walls away from the centre.
    """

    retraction_mm: float = 0.0
    load_mm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.retraction_mm <= 12.0 or not -5.0 <= self.load_mm <= 5.0:
            raise InvalidInputError(
                f"retraction is {self.retraction_mm:g} mm and volume load {self.load_mm:g} mm; needed 0 to "
                "12 mm and -5 to 5 mm (more would fold space)"
            )


UNTOUCHED = SurgicalChange()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurgicalField:
    """Displacement of a retractor and of a volume load, relative to the heart-box centre.

    Attributes:
        pressed_mm: (3,) where the retractor presses; push_mm: (3,) how far and in which direction.
        load_mm: shift away from the centre.
    """

    pressed_mm: FloatArray
    push_mm: FloatArray
    load_mm: float

    def at(self, relative_mm: FloatArray) -> FloatArray:
        """Evaluate the (n, 3) displacement at (n, 3) points."""
        apart = ((relative_mm - self.pressed_mm) ** 2).sum(axis=1)
        pressed = np.exp(-0.5 * apart / RETRACTED_OVER_MM**2)[:, None] * self.push_mm
        radius = np.linalg.norm(relative_mm, axis=1, keepdims=True)
        return np.asarray(pressed + self.load_mm * relative_mm / np.hypot(radius, LOAD_CENTER_MM))


def surgical_field(
    vertices_mm: FloatArray, change: SurgicalChange, rng: np.random.Generator
) -> SurgicalField | None:
    """Draw where and how a retractor presses on a surface; None for an untouched heart.

    Args:
        vertices_mm: (v, 3) of the epicardium at end-diastole, frame "mr".
    """
    if change == UNTOUCHED:
        return None
    center = 0.5 * (vertices_mm.min(axis=0) + vertices_mm.max(axis=0))
    side, inward = FREE_WALL + 0.3 * rng.normal(size=3), -FREE_WALL + 0.3 * rng.normal(size=3)
    relative = vertices_mm - center
    pressed = relative[int(np.argmax(relative @ side))]
    return SurgicalField(pressed, change.retraction_mm * inward / np.linalg.norm(inward), change.load_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SmoothField:
    """Smooth displacement m(x) = Σ A cos(k·x) + B sin(k·x) + surgery(x) − t − ω×(x − c), frame "mr".

    Attributes:
        waves: (m, 3) wave vectors, rad/mm.
        cosine, sine: (m, 3) amplitudes, mm.
        shift_mm: (3,) removed translation.
        turn_rad: (3,) removed rotation vector.
        center_mm: (3,) heart-box centre.
        rms_mm: root mean square of |m| over the heart box.
        surgery: of a retractor and a volume load; None: random waves alone.
    """

    waves: FloatArray
    cosine: FloatArray
    sine: FloatArray
    shift_mm: FloatArray
    turn_rad: FloatArray
    center_mm: FloatArray
    rms_mm: float
    surgery: SurgicalField | None = None

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        """Evaluate the (n, 3) displacement at (n, 3) points."""
        if self.rms_mm == 0:
            return np.zeros_like(xyz_mm)
        relative = np.ascontiguousarray(xyz_mm - self.center_mm)
        wave = np.empty_like(relative)
        wave_sum(relative, self.waves, self.cosine, self.sine, wave)
        if self.surgery is not None:
            wave += self.surgery.at(relative)
        return np.asarray(wave - self.shift_mm - np.cross(self.turn_rad, relative))

    def forward(self, xyz_mm: FloatArray) -> FloatArray:
        """Map pre-operative to intra-operative positions."""
        return np.asarray(xyz_mm + self.at(xyz_mm))

    def inverse(self, xyz_mm: FloatArray, tolerance_mm: float = 1e-4) -> FloatArray:
        """Map intra-operative to pre-operative positions by fixed-point iteration."""
        if self.rms_mm == 0:
            return np.array(xyz_mm, dtype=np.float64)
        out = np.array(xyz_mm, dtype=np.float64)
        for _ in range(30):
            correction = xyz_mm - out - self.at(out)
            out += correction
            if np.abs(correction).max(initial=0.0) < tolerance_mm:
                break
        return out


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TabulatedMap:
    """Smooth map of space on a grid, cubic between nodes: x + displacement(x).

    Attributes:
        displacement_mm: (nx, ny, nz, 3).
        origin_mm: (3,) first node.
        spacing_mm: node pitch.
    """

    displacement_mm: FloatArray
    origin_mm: FloatArray
    spacing_mm: float

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        """Map (n, 3) points."""
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        cubic_at(points, self.displacement_mm, self.origin_mm, 1.0 / self.spacing_mm, out)
        return points + out


def tabulated(
    image: Callable[[FloatArray], FloatArray], box_mm: FloatArray, spacing_mm: float = TABLE_MM
) -> TabulatedMap:
    """Tabulate a map of (n, 3) points over `box_mm` (2, 3) and one node around it."""
    origin = box_mm[0] - spacing_mm
    count = np.ceil((box_mm[1] - box_mm[0]) / spacing_mm).astype(int) + 3
    axes = [origin[k] + spacing_mm * np.arange(count[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    flat = nodes.reshape(-1, 3)
    return TabulatedMap((image(flat) - flat).reshape(nodes.shape), origin, spacing_mm)


def tabulated_inverse(field: SmoothField, box_mm: FloatArray) -> TabulatedMap:
    """Tabulate `field.inverse` over `box_mm` (2, 3); to about 0.001 mm for a 5 mm field."""
    return tabulated(field.inverse, box_mm)


def random_mismatch(
    box_mm: FloatArray,
    rms_mm: float,
    rng: np.random.Generator,
    correlation_mm: float = CORRELATION_MM,
    modes: int = MODES,
    surgery: SurgicalField | None = None,
) -> SmoothField:
    """Draw a smooth random field of exactly `rms_mm` over the heart box, and add surgery's; no rigid part.

    The rigid part (shift and small rotation) of both is removed by least squares over a uniform grid of the
    box, so that the true pose stays the best rigid pose.

    Args:
        box_mm: (2, 3) heart box, frame "mr".
        rms_mm: root mean square of the 3-D displacement, 0 … 8 mm.
        rng: draws the field.
        correlation_mm: SD of the Gaussian correlation of the field.
        modes: number of random waves.
        surgery: displacement of surgery, relative to the middle of the box.
    Raises:
        InvalidInputError: negative or too large RMS.
    """
    if not 0 <= rms_mm <= 8:
        raise InvalidInputError(f"mismatch is {rms_mm:g} mm RMS; needed 0 to 8 mm (more would fold space)")
    center = box_mm.mean(axis=0)
    waves = rng.normal(0.0, 1.0 / correlation_mm, (modes, 3))
    cosine, sine = rng.normal(size=(2, modes, 3))
    zero = np.zeros(3)
    if rms_mm == 0 and surgery is None:
        return SmoothField(waves, cosine, sine, zero, zero, center, 0.0)
    # cell centres: the mean over them is the mean over the volume
    middle = (np.arange(_FIT_CELLS) + 0.5) / _FIT_CELLS
    axes = [box_mm[0, k] + middle * (box_mm[1, k] - box_mm[0, k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    raw = SmoothField(waves, cosine, sine, zero, zero, center, 1.0).at(nodes)
    shift, turn = _rigid_part(nodes - center, raw)
    rest = raw - shift - np.cross(turn, nodes - center)
    gain = rms_mm / float(np.sqrt((rest**2).sum(axis=1).mean()))
    smooth = SmoothField(waves, cosine * gain, sine * gain, shift * gain, turn * gain, center, rms_mm)
    return smooth if surgery is None else _with_surgery(smooth, surgery, nodes)


def _with_surgery(smooth: SmoothField, surgery: SurgicalField, nodes_mm: FloatArray) -> SmoothField:
    """Add the displacement of surgery without its rigid part over the (n, 3) nodes of the box."""
    relative = nodes_mm - smooth.center_mm
    shift, turn = _rigid_part(relative, surgery.at(relative))
    both = replace(
        smooth, shift_mm=smooth.shift_mm + shift, turn_rad=smooth.turn_rad + turn, rms_mm=1.0, surgery=surgery
    )
    return replace(both, rms_mm=float(np.sqrt((both.at(nodes_mm) ** 2).sum(axis=1).mean())))


def _rigid_part(relative_mm: FloatArray, field_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit shift (3,) and small rotation vector (3,) to a displacement field by least squares.

    The nodes are those of a box about its centre: their first and mixed second moments vanish, and the normal
    equations separate into one quotient for each unknown, summed in an order independent of threads.
    """
    moments = (relative_mm**2).sum(axis=0)
    torque = np.cross(relative_mm, field_mm).sum(axis=0)
    return field_mm.mean(axis=0), torque / (moments.sum() - moments)
