"""LC2 of a slice set against the phase-matched model, as a function of the pose."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, require_same_frame
from dvf_ig.kernels.similarity import integrate, lc2_slices

from .channels import ModelChannels
from .slices import SliceSet


@dataclass(frozen=True, slots=True)
class Score:
    """similarity in [0, 1] (share of local ultrasound variance explained), overlap in [0, 1]."""

    similarity: float
    overlap: float


class Lc2:
    """Scores a pose. Holds scratch memory, so one instance serves one thread of Python.

    Source: Wein 2013, eq. 3–5. Differs from source: 2-D patches in the tracked slices, phase-matched volumes.
    """

    def __init__(self, slices: SliceSet, model: ModelChannels, *, patch_mm: float, pitch_mm: float) -> None:
        self._slices = slices
        self._model = model
        self._phases = model.nearest_phase(slices.model_phase)
        self._radius = max(2, round(patch_mm / pitch_mm / 2))
        self._min_count = 0.6 * (2 * self._radius + 1) ** 2
        s, rows, cols = slices.images.shape
        size = (s, rows + 2 * self._radius + 1, cols + 2 * self._radius + 1)
        self._sums = [np.empty(size) for _ in range(3)]
        u = slices.images.astype(np.float64)
        for table, image in zip(self._sums, (slices.masks.astype(np.float64), u, u * u), strict=True):
            for k in range(s):
                integrate(image[k], self._radius, table[k])
        self._values = np.empty((s, 2, rows, cols))
        self._tables = np.empty((s, 7, *size[1:]))
        self._out = np.empty((s, 3))
        self._index_from_mm = np.linalg.inv(model.grid.axes_mm)

    def per_slice(self, mr_from_tracker: Rigid) -> FloatArray:
        """(s, 3) weighted score, weight and overlap of each slice."""
        require_same_frame(self._slices.frame, mr_from_tracker.source, "registration pose")
        require_same_frame(self._model.grid.frame, mr_from_tracker.target, "registration pose")
        mr_from_pixel = mr_from_tracker.rotation @ self._slices.frame_from_pixel
        mr_from_pixel[:, :, 2] += mr_from_tracker.translation_mm - self._model.grid.origin_mm
        lc2_slices(
            self._slices.images,
            self._slices.masks,
            *self._sums,
            np.ascontiguousarray(self._index_from_mm @ mr_from_pixel),
            self._phases,
            self._model.values,
            self._radius,
            self._min_count,
            self._values,
            self._tables,
            self._out,
        )
        return self._out.copy()

    def score(self, mr_from_tracker: Rigid) -> Score:
        """Similarity and overlap of all slices together."""
        out = self.per_slice(mr_from_tracker)
        return Score(float(out[:, 0].sum() / max(out[:, 1].sum(), 1e-300)), float(out[:, 2].mean()))

    def independent_patches(self) -> float:
        """How many patches fit into the slices without sharing pixels."""
        return float(self._slices.masks.sum()) / (2 * self._radius + 1) ** 2
