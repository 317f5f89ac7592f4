"""Tissue of a beating organ: its labels at one phase, and the motion that leads there from every other."""

from dataclasses import dataclass, replace

import numpy as np

from .arrays import FloatArray, IntArray
from .errors import InvalidInputError
from .space.frames import require_same_frame
from .space.volume import Volume
from .space.warp import Warp
from .timing.cycle import CycleTiming


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """Labels of end-diastole that the motion carries to every phase.

    Attributes:
        labels: uint8, 0 is background.
        names: value and anatomical name of each label.
        motion: one pull-back for each phase of the model: material at q was at q − m(q) at end-diastole.
    Raises:
        InvalidInputError: labels of another type; FrameMismatchError: a motion in another frame.
    """

    labels: Volume
    names: tuple[tuple[int, str], ...]
    motion: tuple[Warp, ...]

    def __post_init__(self) -> None:
        if self.labels.values.dtype != np.uint8:
            raise InvalidInputError(f"labels of tissue are {self.labels.values.dtype}; needed uint8")
        for warp in self.motion:
            require_same_frame(self.labels.grid.frame, warp.frame, "motion of tissue")

    def material_mm(self, xyz_mm: FloatArray, model_phase: float, timing: CycleTiming) -> FloatArray:
        """Map (n, 3) places at a phase of the cycle to their material at end-diastole."""
        first, second, share = timing.bracket(model_phase)
        before, after = (self.motion[i].at(xyz_mm)[0] for i in (first, second))
        return np.asarray(xyz_mm - (1.0 - share) * before - share * after)

    def contracting(self, contraction: float) -> "Tissue":
        """Return the tissue of an organ that moves so many times as far."""
        if contraction == 1.0:
            return self
        motion = [replace(warp, coefficients=contraction * warp.coefficients) for warp in self.motion]
        return replace(self, motion=tuple(motion))

    def label_at(self, xyz_mm: FloatArray, model_phase: float, timing: CycleTiming) -> IntArray:
        """Look up (n,) labels at (n, 3) places at a phase of the cycle; 0 outside the labelled box."""
        grid = self.labels.grid
        index = grid.to_index(self.material_mm(xyz_mm, model_phase, timing))
        values = self.labels.values[grid.nearest(index)]
        return np.where(grid.holds(index, 0.5), values, 0).astype(np.int64)

    def name(self, label: int) -> str:
        """Return the name of a label, "label N" if it has none."""
        return dict(self.names).get(label, f"label {label}")
