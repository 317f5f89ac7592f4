"""Wall normals: across a slab, around a shell, none where there is no wall."""

import numpy as np

from data_synth.heart.fibre_orientation import STRIDE, fibre_orientation
from data_synth.heart.tissue import ANISOTROPY_DB, Tissue


def test_normals_of_a_slab_are_across_it_and_full_drop() -> None:
    codes = np.full((48, 40, 40), Tissue.LV_BLOOD, dtype=np.uint8)
    codes[20:28] = Tissue.LV_MYOCARDIUM
    middle = fibre_orientation(codes, 1.25)[24 // STRIDE, 10, 10]
    np.testing.assert_allclose(np.abs(middle), [np.sqrt(ANISOTROPY_DB), 0, 0], atol=0.02)


def test_normals_of_a_shell_point_outwards() -> None:
    xyz = np.stack(np.meshgrid(*[np.arange(80.0) - 39.5] * 3, indexing="ij"), axis=-1)
    radius = np.linalg.norm(xyz, axis=-1)
    codes = np.where((radius > 22) & (radius < 31), Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD).astype(np.uint8)
    normals = fibre_orientation(codes, 1.0)
    coarse, r = xyz[::STRIDE, ::STRIDE, ::STRIDE], radius[::STRIDE, ::STRIDE, ::STRIDE]
    wall = (r > 23) & (r < 30)
    unit = normals[wall] / np.linalg.norm(normals[wall], axis=-1, keepdims=True)
    off_deg = np.degrees(np.arccos(np.minimum(1, np.abs((unit * coarse[wall]).sum(axis=-1)) / r[wall])))
    assert np.percentile(off_deg, 99) < 6
    assert np.percentile((normals[wall] ** 2).sum(axis=-1), 5) > 0.8 * ANISOTROPY_DB


def test_no_muscle_no_fibres() -> None:
    assert not fibre_orientation(np.full((9, 9, 9), Tissue.LIVER, dtype=np.uint8), 1.0).any()
