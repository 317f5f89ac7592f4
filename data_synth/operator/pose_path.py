"""Rigid motions as functions of time, composed like transforms."""

import numpy as np

from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray


def composed(left: PosePath, right: PosePath) -> PosePath:
    """left(t) @ right(t)."""

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        turn, shift = left(t_s)
        rotations, translations = right(t_s)
        return turn @ rotations, np.einsum("nij,nj->ni", turn, translations) + shift

    return path


def inverted(path: PosePath) -> PosePath:
    """Invert a target_from_source path."""

    def inverse(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        rotations, translations = path(t_s)
        back = np.swapaxes(rotations, 1, 2)
        return back, -np.einsum("nij,nj->ni", back, translations)

    return inverse
