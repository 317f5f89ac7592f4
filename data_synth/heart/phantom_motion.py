"""Motion of the four-chamber phantom: closed form in the left ventricle, a smooth flow around it."""

from dataclasses import dataclass

import numpy as np

from data_synth.kernels import heart_motion
from dvf_ig.core import FloatArray, Rigid, read_only_arrays

from .mismatch import TabulatedMap
from .motion import ES_FRACTION, StillRegion, activation
from .warp import PlacedWarp


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhantomMotion:
    """Motion χ and χ⁻¹ of the phantom in frame "mr", for any phase.

    A person's heart W(standard heart) moves by W ∘ χ_standard ∘ W⁻¹. ‖χ(χ⁻¹(x)) − x‖ stays below 0.01 mm for
    the standard heart and below 0.05 mm for others, creases at the walls included (see `motion_report`).

    Attributes:
        mr_from_heart: pose of the heart.
        lobes: (n, 7) swelling atria, see `kernels.flow.velocity`.
        scale: factor on the activation.
        cavity: (6,) cavity of the left ventricle, see `kernels.lv`.
        es_fraction: peak of the activation, as a fraction of the cycle.
        warp: W; None: the standard heart.
        before: map of a point to the standard heart's contracted state, mismatch undone; None: identity.
        still: region that does not contract; None: all of the heart does.
    """

    mr_from_heart: Rigid
    lobes: FloatArray
    scale: float
    cavity: FloatArray
    es_fraction: float = ES_FRACTION
    warp: PlacedWarp | None = None
    before: TabulatedMap | None = None
    still: StillRegion | None = None

    @property
    def _place(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        return self.mr_from_heart.rotation, self.mr_from_heart.translation_mm, self.lobes, self.cavity

    def levels(self, model_phase: FloatArray | float, count: int) -> FloatArray:
        """Compute (count,) activations at one phase, or at (count,) of them."""
        phase = model_phase if self.es_fraction == ES_FRACTION else self._usual_phase(model_phase)
        return np.array(np.broadcast_to(self.scale * activation(phase), (count,)))

    def push_forward(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Apply χ: (n, 3) positions of (n, 3) reference points, without mismatch."""
        start = xyz_mm if self.warp is None else self.warp.inverse(xyz_mm)
        return self.push_standard(start, model_phase)

    def push_standard(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Move (n, 3) points of the standard heart from end-diastole, W⁻¹(reference points)."""
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        points, *place = read_only_views(points, *self._place)
        levels = self.levels(model_phase, len(points))
        if self.still is not None:
            levels *= self.still.moving_share(points)
        heart_motion.forward(points, levels, *place, out)
        return out if self.warp is None else self.warp.forward(out)

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Apply χ⁻¹ after the inverse mismatch: (n, 3) reference positions of (n, 3) points."""
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        field = _NO_FIELD if self.before is None else self.before
        points, *place, still = read_only_views(
            points, *self._place, field.displacement_mm, field.origin_mm, self._still_in_heart
        )
        levels = self.levels(model_phase, len(points))
        heart_motion.inverse(points, levels, *place, 1.0 / field.spacing_mm, still, out)
        return out if self.warp is None else self.warp.table.at(out)

    @property
    def _still_in_heart(self) -> FloatArray:
        """Middle of the still region in frame "heart" and its radius (4,), mm; radius 0: none."""
        if self.still is None:
            return np.zeros(4)
        return np.append(self.mr_from_heart.inverse().apply_array(self.still.center_mm), self.still.radius_mm)

    def _usual_phase(self, model_phase: FloatArray | float) -> FloatArray:
        """Find the phase at which the activation curve has this heart's level at `model_phase`."""
        phase = np.asarray(model_phase, dtype=np.float64) % 1.0
        return np.interp(phase, [0.0, self.es_fraction, 1.0], [0.0, ES_FRACTION, 1.0])


def read_only_views(*arrays: FloatArray) -> list[FloatArray]:
    """View arrays as read-only, for which kernels are compiled once, whoever owns them."""
    views = [array.view() for array in arrays]
    for view in views:
        view.setflags(write=False)
    return views


_NO_FIELD = TabulatedMap(np.zeros((0, 0, 0, 3)), np.zeros(3), 1.0)
