"""Labels of end-diastole and the motion back to them: where the material of a point was."""

import numpy as np
from toy_ball import ball_model
from toy_sphere import sphere

from dvf_ig.core import CycleTiming, FloatArray, Grid, Mesh, Preop, Volume, VolumeSeries
from dvf_ig.preop.tissue import tissue_of_cine, tissue_of_labels


def shells(radius_mm: FloatArray) -> Preop:
    """A ball of wall about blood whose left half has another label, smaller at later phases."""
    grid = Grid.axis_aligned("mr", (40, 40, 40), np.full(3, -39.0), 2.0)
    xyz = grid.centers_mm()
    r, left = np.linalg.norm(xyz, axis=-1), xyz[..., 0] < 0.0
    phases = [np.where(r < one - 9.0, 2, np.where(r < one, np.where(left, 3, 1), 0)) for one in radius_mm]
    timing = CycleTiming(np.arange(len(radius_mm)) / len(radius_mm), 1.0)
    names = ((1, "wall"), (2, "lv_blood"), (3, "scar"))
    return Preop(
        "ball",
        labels=VolumeSeries(grid, np.array(phases, dtype=np.uint8), timing),
        label_names=names,
        organ_labels=(1, 2, 3),
    )


def test_labels_of_every_phase_give_the_motion_back_to_end_diastole() -> None:
    radii_mm = 27.0 + 3.0 * np.cos(2.0 * np.pi * np.arange(8) / 8)
    preop = shells(radii_mm)
    tissue = tissue_of_labels(preop, [Mesh("mr", *sphere(radius, 2)) for radius in radii_mm.tolist()], 0)
    assert tissue is not None
    assert preop.labels is not None
    timing = preop.labels.timing
    way = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.6, 0.0, 0.8]])
    for phase, radius_mm in ((0, 30.0), (4, 24.0), (2, 27.0)):
        material = tissue.material_mm(radius_mm * way, phase / 8, timing)
        assert np.linalg.norm(material - 30.0 * way, axis=1).max() < 1.0
        assert tissue.label_at((radius_mm - 4.0) * way, phase / 8, timing).tolist() == [1, 3, 1]
    assert tissue.label_at(np.full((1, 3), 200.0), 0.0, timing).tolist() == [0]


def test_a_known_motion_is_inverted() -> None:
    sphere = ball_model()
    reference: list[Mesh] = [sphere.reference[0]] * 2
    labels = Volume(Grid.axis_aligned("mr", (8, 8, 8), np.full(3, -40.0), 10.0), np.ones((8, 8, 8), np.uint8))

    def moved(xyz_mm: FloatArray) -> FloatArray:
        return xyz_mm + 3.0 * np.sin(xyz_mm[:, ::-1] / 20.0) + np.array([4.0, 0.0, 0.0])

    tissue = tissue_of_cine(labels, (), reference, 0, [lambda xyz_mm: xyz_mm, moved])
    rng = np.random.default_rng(1)
    at_rest = rng.uniform(-15.0, 15.0, (200, 3))
    timing = CycleTiming(np.array([0.0, 0.5]), 1.0)
    back = tissue.material_mm(moved(at_rest), 0.5, timing)
    assert np.abs(back - at_rest).max() < 0.05
    assert np.abs(tissue.material_mm(at_rest, 0.0, timing) - at_rest).max() == 0.0
