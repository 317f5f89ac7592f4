"""Simple media in which the simulator's physics has a closed-form answer."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.heart.fibre_orientation import no_fibres
from data_synth.heart.reference import CHANNELS, ReferenceMap
from data_synth.heart.tissue import ACOUSTICS, BLOOD, Tissue
from dvf_ig.core import FloatArray, read_only_arrays


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RigidShift:
    """Rigid motion of everything: x = R X + shift, at every phase except 0."""

    shift_mm: FloatArray
    turn_rad: FloatArray

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        back = Rotation.from_rotvec(-self.turn_rad).apply(xyz_mm - self.shift_mm)
        moved = np.broadcast_to(np.asarray(model_phase), (len(xyz_mm),))[:, None] != 0
        return np.where(moved, back, xyz_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Medium:
    """Medium of homogeneous tissue, or of two halves that meet in a plane; frame "mr"."""

    reference: ReferenceMap
    inverse_motion: RigidShift


def medium(
    tissue: Tissue,
    beyond: Tissue | None = None,
    *,
    axis: int = 0,
    absorbing: bool = False,
    reflecting: bool = False,
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Medium:
    """Build a medium of `tissue`, with the tissue `beyond` (if given) at positive coordinates of `axis`.

    Args:
        absorbing: with the tissues' attenuation; otherwise none.
        reflecting: with their impedances, the border blended over 2 mm; otherwise one impedance.
        shift_mm, turn_rad: rigid motion of the medium at phases other than 0.
    """
    fields = np.empty((81, 5, 5, CHANNELS), dtype=np.float32)
    fields[:41] = _row(tissue, absorbing, reflecting)
    fields[41:] = _row(tissue if beyond is None else beyond, absorbing, reflecting)
    fields[..., -1] = np.abs(np.gradient(fields[..., 0], 1.0, axis=0))
    if reflecting:
        # |∇ ln Z| on the two nodes of the border, between which ln Z is linear
        fields[..., -1] *= 2.0
    order = [1, 2]
    order.insert(axis, 0)
    fields = np.ascontiguousarray(np.transpose(fields, (*order, 3)))
    # the 81 nodes are 1 mm apart, the border at 0; outside the grid its outermost values apply
    origin = np.full(3, -2.0)
    origin[axis] = -40.5
    unused = np.zeros(fields.shape[:3], dtype=np.float32)
    codes = np.zeros(fields.shape[:3], dtype=np.uint8)
    reference = ReferenceMap(origin, 1.0, unused, codes, codes, unused, fields, no_fibres())
    return Medium(reference, RigidShift(np.array(shift_mm), np.array(turn_rad)))


def _row(tissue: Tissue, absorbing: bool, reflecting: bool) -> list[float]:
    a = ACOUSTICS[tissue]
    level = 10 ** (a.echo_db / 20)
    scatter = [0.0, level] if tissue in BLOOD else [level, 0.0]
    impedance = float(np.log(a.impedance_mrayl)) if reflecting else 0.5
    return [impedance, a.attenuation_db if absorbing else 0.0, *scatter, 0.0]
