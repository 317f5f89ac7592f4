"""Cycle timing, grids, meshes, landmarks, signals: what they promise and what they refuse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dvf_ig.core as core
from dvf_ig.core import CycleTiming, Fan, Grid, InvalidInputError, Landmarks, Mesh, Points, Signal, Volume
from dvf_ig.core.space.mesh import enclosed_volume_mm3

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@given(st.floats(0, 5), st.integers(2, 30))
def test_bracket_weights_reproduce_the_phase(phi: float, n: int) -> None:
    timing = CycleTiming.uniform(n, 0.8)
    first, second, alpha = timing.bracket(phi)
    assert 0 <= alpha <= 1
    assert second == (first + 1) % n
    got = (timing.fractions[first] + alpha / n) % 1.0
    assert abs((got - phi + 0.5) % 1.0 - 0.5) < 1e-9


def test_uneven_phases_wrap() -> None:
    timing = CycleTiming(np.array([0.1, 0.4, 0.7]), 0.9)
    assert timing.bracket(0.0)[:2] == (2, 0)
    assert timing.bracket(0.0)[2] == pytest.approx(0.75)  # 0.3 of the 0.4 from 0.7 to 1.1


@pytest.mark.parametrize("fractions", [[0.0], [0.2, 0.1], [0.0, 1.0], [-0.1, 0.5], [0.3, 0.3]])
def test_impossible_phase_times_are_refused(fractions: list[float]) -> None:
    with pytest.raises(InvalidInputError):
        CycleTiming(np.array(fractions), 0.8)


def test_rr_in_milliseconds_is_recognised() -> None:
    with pytest.raises(InvalidInputError, match="is it in ms"):
        CycleTiming.uniform(20, 860.0)


def test_grid_maps_there_and_back() -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    grid = Grid("mr", (4, 5, 6), np.array([10.0, 20, 30]), np.array([1.0, 2, 3]), turn)
    np.testing.assert_allclose(grid.to_mm(np.array([1.0, 0, 0])), [10, 21, 30])
    index = np.random.default_rng(0).uniform(-2, 9, (20, 3))
    np.testing.assert_allclose(grid.to_index(grid.to_mm(index)), index, atol=1e-12)
    assert grid.centers_mm().shape == (4, 5, 6, 3)


def test_volume_owns_its_values() -> None:
    values = np.zeros((2, 2, 2))
    volume = Volume(Grid.axis_aligned("mr", (2, 2, 2), np.zeros(3), 1.0), values)
    values[0, 0, 0] = 7
    assert volume.values[0, 0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        volume.values[0, 0, 0] = 1


def test_tetrahedron_volume_is_known_wherever_it_lies() -> None:
    for shift in (0.0, 1000.0):
        assert enclosed_volume_mm3(TETRA + shift, FACES) == pytest.approx(1 / 6, rel=1e-9)


def test_mesh_with_a_dangling_index_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="vertex 9"):
        Mesh("mr", TETRA, np.array([[0, 1, 9]]))


def test_landmarks_pair_by_name_in_the_first_ones_order() -> None:
    first = Landmarks(("apex", "rv", "aorta"), Points("mr", np.arange(9.0).reshape(3, 3)))
    second = Landmarks(("aorta", "extra", "apex"), Points("tracker", np.arange(9.0, 18).reshape(3, 3)))
    names, mine, theirs = first.paired_with(second)
    assert names == ("apex", "aorta")
    np.testing.assert_allclose(mine.xyz_mm[1], [6, 7, 8])
    np.testing.assert_allclose(theirs.xyz_mm[0], [15, 16, 17])


def test_signal_cuts_by_time() -> None:
    signal = Signal(np.arange(100.0)[:, None], 10.0, 5.0, ("II",))
    cut = signal.between(6.0, 8.0)
    assert cut.start_s == 6.0
    np.testing.assert_allclose(cut.samples[:, 0], np.arange(10, 30))


def test_fan_mask_has_the_sectors_area() -> None:
    fan = Fan(np.array([150.0, 0.0]), 20.0, 180.0, np.pi / 4)
    area = np.pi / 4 * (180**2 - 20**2)
    assert fan.mask(200, 301).sum() == pytest.approx(area, rel=0.01)


def test_every_exported_name_is_importable_and_documented() -> None:
    aliases = {"Progress"}  # of a type, like the arrays; its module says what it is
    names = [n for n in vars(core) if not n.startswith("_") and n[0].isupper() and "Array" not in n]
    names = [n for n in names if n not in aliases]
    undocumented = [n for n in names if not getattr(core, n).__doc__]
    assert undocumented == []
