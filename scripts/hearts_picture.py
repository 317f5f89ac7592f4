"""Drawn hearts side by side: short axis and long axis at end-diastole and end-systole, with their sizes.

Usage: python scripts/hearts_picture.py OUT.png [FIRST_SEED [COUNT [KIND]]]
"""

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.heart_spec import HEART_KINDS, HeartKind, HeartSpec
from data_synth.heart.motion_report import jacobian_determinant
from data_synth.heart.reference import tissue_at
from data_synth.heart.tissue import Tissue, bssfp_signal
from data_synth.kernels import lv
from dvf_ig.core import FloatArray

HALF_MM, STEP_MM = 75.0, 1.0
VOLUME_STEP_MM = 3.0
GREY = np.zeros(max(Tissue) + 1)
for _tissue in Tissue:
    GREY[int(_tissue)] = bssfp_signal(_tissue)


def plane(anatomy: PhantomAnatomy, model_phase: float, place: Callable[..., FloatArray]) -> FloatArray:
    """Compute MR contrast over a plane; `place` maps its two coordinates to the heart frame."""
    axis = np.arange(-HALF_MM, HALF_MM, STEP_MM)
    u, v = np.meshgrid(axis, axis, indexing="xy")
    local = place(u.ravel(), v.ravel())
    xyz = anatomy.shapes.mr_from_heart.apply_array(local)
    codes = tissue_at(anatomy.shapes, anatomy.resting_motion.pull_back(xyz, model_phase), ultrasound=False)
    return GREY[codes].reshape(u.shape)


def sizes(anatomy: PhantomAnatomy) -> str:
    """Describe volumes, ejection fractions and wall."""
    axes = [np.arange(low, high, VOLUME_STEP_MM) for low, high in anatomy.box_mm.T]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    codes = tissue_at(anatomy.shapes, nodes, ultrasound=False)
    ml = VOLUME_STEP_MM**3 / 1e3
    full, empty = {}, {}
    for tissue in (Tissue.LV_BLOOD, Tissue.RV_BLOOD, Tissue.LA_BLOOD):
        voxels = nodes[codes == tissue]
        full[tissue] = len(voxels) * ml
        empty[tissue] = float(jacobian_determinant(anatomy, voxels, anatomy.es_fraction).sum() * ml)
    radii = lv.radii(48.0, anatomy.shapes.heart.lv_cavity)
    walls = []
    for side in (1.0, -1.0):
        outer, inner = anatomy.placed(np.array([[side * r, 0.0, 48.0] for r in radii]))
        walls.append(float(np.linalg.norm(outer - inner)))
    left, right, atrium = Tissue.LV_BLOOD, Tissue.RV_BLOOD, Tissue.LA_BLOOD
    return (
        f"{anatomy.kind} {anatomy.seeds.anatomy}\n"
        f"LV {full[left]:.0f} ml EF {1 - empty[left] / full[left]:.2f}\n"
        f"RV {full[right]:.0f} ml EF {1 - empty[right] / full[right]:.2f}  LA {empty[atrium]:.0f} ml\n"
        f"septum {walls[0]:.0f}, lateral {walls[1]:.0f} mm"
    )


def row(anatomy: PhantomAnatomy, axes: list[Axes]) -> None:
    """Draw short and long axis at both phases."""
    apex, base = anatomy.shapes.mr_from_heart.inverse().apply_array(anatomy.long_axis_mm)
    middle = apex + 0.55 * (base - apex)
    tilt = (base - apex) / np.linalg.norm(base - apex)
    across = np.array([1.0, 0.0, 0.0]) - tilt[0] * tilt
    across /= np.linalg.norm(across)

    def short(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(middle + (u[:, None] + 15.0) * across + v[:, None] * np.cross(tilt, across))

    def long(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(middle + 12.0 * tilt + (u[:, None] + 15.0) * across - v[:, None] * tilt)

    views = [(place, phase) for place in (short, long) for phase in (0.0, anatomy.es_fraction)]
    for ax, (place, phase) in zip(axes, views, strict=True):
        ax.imshow(plane(anatomy, phase, place), cmap="gray", vmin=0, vmax=GREY.max())
        ax.axis("off")
    axes[0].set_title(sizes(anatomy), fontsize=7, loc="left")


def main() -> None:
    out = Path(sys.argv[1])
    first, count = (
        int([*sys.argv, "1001"][2]) if len(sys.argv) > 2 else 1001,
        int(sys.argv[3]) if len(sys.argv) > 3 else 12,
    )
    kind: HeartKind = next((name for name in HEART_KINDS if name in sys.argv[4:]), "varied")
    rows = (count + 2) // 3
    figure, grid = plt.subplots(rows, 12, figsize=(18, 2.1 * rows), squeeze=False)
    for ax in grid.ravel():
        ax.axis("off")
    for k in range(count):
        spec = HeartSpec(kind)
        anatomy = phantom_anatomy(motion="physiological", mismatch_mm=0.0, seed=first + k, heart=spec)
        row(anatomy, list(grid[k // 3, 4 * (k % 3) : 4 * (k % 3) + 4]))
    figure.tight_layout(pad=0.2)
    figure.savefig(out, dpi=80)
    print(out)


if __name__ == "__main__":
    main()
