"""The phantom heart: watertight moving surface, tissue consistent with it, pre-operative images of it."""

from collections import Counter

import numpy as np
import pytest

from data_synth.heart.anatomy import PhantomAnatomy, _at_rest, phantom_anatomy
from data_synth.heart.tissue import FIRST_OUTSIDE, Tissue, bssfp_signal
from data_synth.mr.cine import MrProtocol, cine_preop
from dvf_ig.core import FloatArray, InvalidInputError, Preop
from dvf_ig.core.space.mesh import enclosed_volume_mm3


@pytest.fixture(scope="module")
def preop(anatomy: PhantomAnatomy) -> Preop:
    """Voxels of six times the usual volume: enough to count tissue in."""
    return cine_preop(anatomy, np.random.default_rng(5), MrProtocol(spacing_mm=3.3))


def vertex_normals(vertices: FloatArray, triangles: FloatArray) -> FloatArray:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, triangles[:, k], np.cross(b - a, c - a))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def volume_ml(preop: Preop, tissue: Tissue, phase: int) -> float:
    assert preop.labels is not None
    voxel = float(np.prod(preop.labels.grid.spacing_mm)) / 1000
    return float((preop.labels.values[phase] == tissue).sum()) * voxel


def test_surface_is_closed_outward_and_fine_enough(anatomy: PhantomAnatomy) -> None:
    triangles = anatomy.surface_triangles
    edges = Counter(
        tuple(edge) for t in triangles.tolist() for edge in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))
    )
    assert max(edges.values()) == 1
    assert all((b, a) in edges for a, b in edges)
    for phase in (0.0, 0.36):
        assert enclosed_volume_mm3(anatomy.surface_vertices(phase), triangles) > 4e5
    assert 8000 <= len(anatomy.surface_vertices(0.0)) <= 11_000


def test_tissue_changes_at_the_moving_surface(anatomy: PhantomAnatomy) -> None:
    for phase in (0.0, 0.36, 0.7):
        vertices = anatomy.surface_vertices(phase)[::7]
        normals = vertex_normals(anatomy.surface_vertices(phase), anatomy.surface_triangles)[::7]
        within = anatomy.tissue(vertices - 0.3 * normals, phase)
        beyond = anatomy.tissue(vertices + 0.3 * normals, phase)
        assert ((within > 0) & (within < FIRST_OUTSIDE)).mean() > 0.995
        assert ((beyond == 0) | (beyond >= FIRST_OUTSIDE)).mean() > 0.995


def test_material_is_the_exact_inverse_of_the_motion(anatomy: PhantomAnatomy) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(anatomy.box_mm[0], anatomy.box_mm[1], (3000, 3))
    for phase in (0.1, 0.36, 0.9):
        back = anatomy.mismatch.forward(anatomy.deformed(anatomy.material(points, phase), phase))
        assert np.linalg.norm(back - points, axis=1).max() < 0.05


def test_imaged_surface_is_the_true_one(anatomy: PhantomAnatomy) -> None:
    """What imaging goes back through puts surfaces where they are."""
    for phase in (0.0, 0.2, 0.36):
        depth = anatomy.shapes.organ(anatomy.inverse_motion.pull_back(anatomy.surface_vertices(phase), phase))
        assert np.abs(depth).max() < 0.05


def test_largest_motion_of_the_named_presets() -> None:
    for motion, low, high in (("physiological", 13.0, 15.0), ("paper5mm", 4.7, 5.3)):
        heart = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=2)
        still, contracted = heart.surface_vertices(0.0), heart.surface_vertices(heart.es_fraction)
        assert low < np.linalg.norm(contracted - still, axis=1).max() < high


def test_landmarks_lie_on_the_surface_and_targets_are_many(anatomy: PhantomAnatomy) -> None:
    landmarks, targets = anatomy.landmarks(), anatomy.targets()
    assert 6 <= len(landmarks.names) <= 8
    assert np.abs(anatomy.shapes.organ(landmarks.points.xyz_mm)).max() < 0.01
    assert len(targets.names) >= 10 + 27
    assert np.isclose(targets.points.xyz_mm[-27:].mean(axis=0), anatomy.box_mm.mean(axis=0)).all()
    spread = np.linalg.svd(landmarks.points.xyz_mm - landmarks.points.xyz_mm.mean(axis=0))[1]
    assert spread[2] > 20


def test_same_seed_same_heart_other_seed_another(anatomy: PhantomAnatomy) -> None:
    _at_rest.cache_clear()  # made again, not remembered
    again = phantom_anatomy(motion="physiological", mismatch_mm=1.2, seed=1)
    other = phantom_anatomy(motion="physiological", mismatch_mm=1.2, seed=2)
    assert np.array_equal(again.surface_vertices(0.3), anatomy.surface_vertices(0.3))
    assert not np.allclose(other.box_mm, anatomy.box_mm, atol=1.0)


def test_mismatch_leaves_targets_and_preop_alone(anatomy: PhantomAnatomy) -> None:
    plain = phantom_anatomy(motion="physiological", mismatch_mm=0.0, seed=1)
    assert np.array_equal(plain.targets().points.xyz_mm, anatomy.targets().points.xyz_mm)
    moved = np.linalg.norm(plain.surface_vertices(0.0) - anatomy.surface_vertices(0.0), axis=1)
    assert 0.5 < np.sqrt((moved**2).mean()) < 2.0


def test_preop_ejects_like_a_heart(preop: Preop) -> None:
    full, empty = volume_ml(preop, Tissue.LV_BLOOD, 0), volume_ml(preop, Tissue.LV_BLOOD, 7)
    assert 0.55 < 1 - empty / full < 0.70
    assert 0.4 < 1 - volume_ml(preop, Tissue.RV_BLOOD, 7) / volume_ml(preop, Tissue.RV_BLOOD, 0) < 0.6
    assert volume_ml(preop, Tissue.LA_BLOOD, 7) > 1.25 * volume_ml(preop, Tissue.LA_BLOOD, 0)
    wall = [volume_ml(preop, Tissue.LV_MYOCARDIUM, i) for i in range(20)]
    assert np.ptp(wall) / np.mean(wall) < 0.08


def test_labels_enclose_the_preoperative_surface(anatomy: PhantomAnatomy, preop: Preop) -> None:
    assert preop.labels is not None
    voxel = float(np.prod(preop.labels.grid.spacing_mm))
    for i in (0, 7):
        vertices = anatomy.deformed(anatomy.ed_vertices_mm, i / 20)
        volume = enclosed_volume_mm3(vertices, anatomy.triangles)
        labelled = np.isin(preop.labels.values[i], preop.organ_labels).sum() * voxel
        assert labelled == pytest.approx(volume, rel=0.015)


def test_mr_contrast_and_noise_are_those_of_bssfp(preop: Preop) -> None:
    assert preop.mr is not None
    assert preop.labels is not None
    image, labels = preop.mr.values[0].astype(np.float64), preop.labels.values[0]
    ratio = image[labels == Tissue.LV_BLOOD].mean() / np.median(image[labels == Tissue.LV_MYOCARDIUM])
    assert bssfp_signal(Tissue.LV_BLOOD) / bssfp_signal(Tissue.LV_MYOCARDIUM) == pytest.approx(3.2, abs=0.1)
    assert 2.6 < ratio < 3.4
    assert preop.mr.values.dtype == np.int16
    assert preop.labels.values.dtype == np.uint8
    # Rician noise of blood 800/40 = 20 in air: mean σ√(π/2)
    lung = np.percentile(image, 1)
    assert lung < 120


def test_preop_is_reproducible(anatomy: PhantomAnatomy) -> None:
    def image(seed: int) -> FloatArray:
        short = cine_preop(anatomy, np.random.default_rng(seed), MrProtocol(phases=2, spacing_mm=4.0))
        assert short.mr is not None
        return short.mr.values

    assert np.array_equal(image(5), image(5))
    assert not np.array_equal(image(5), image(6))


def test_bad_requests_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="motion 'wild'"):
        phantom_anatomy(motion="wild", mismatch_mm=0.0, seed=1)
    with pytest.raises(InvalidInputError, match="mismatch"):
        phantom_anatomy(motion="paper5mm", mismatch_mm=-1.0, seed=1)
