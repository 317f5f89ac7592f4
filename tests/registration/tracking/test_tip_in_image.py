"""A tool that ultrasound shows is found where it is, and nothing is said of one that it does not show."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray, ImageMap, Rigid
from dvf_ig.registration import TipPatches, patch_around, sighting, tip_view
from dvf_ig.registration.tracking.tip_in_image import (
    ELSEWHERE_MM,
    LEAST_BESIDE,
    LEAST_IN_PLANE,
    PATCH_MM,
    REACH_MM,
    REMEMBERED_BEATS,
    STEP_MM,
)

OFFSET = np.arange(-PATCH_MM, PATCH_MM + STEP_MM / 2, STEP_MM)
ROW, COLUMN = np.meshgrid(OFFSET, OFFSET, indexing="ij")
MAP = ImageMap(Rigid("probe", "image", np.eye(3), np.array([-40.0, 5.0, 2.0])), np.array([0.5, 0.25]))


def tissue(rng: np.random.Generator) -> FloatArray:
    """Speckle, and the bright edge of a heart through the middle."""
    edge = 60.0 * np.exp(-0.5 * (ROW / 1.5) ** 2)
    return np.asarray(70.0 + edge + 12.0 * rng.standard_normal(ROW.shape))


def beats(
    tool: FloatArray,
    count: int = 8,
    beside: int = 6,
    rng: np.random.Generator | None = None,
    plane_mm: float = 0.0,
) -> TipPatches:
    """So many beats of one image in a plane, which shows the tool, and one 10 mm beside it."""
    drawn = rng or np.random.default_rng(1)
    patches = TipPatches.none()
    for k in range(max(count, beside)):
        images = [(plane_mm, np.minimum(tissue(drawn) + tool, 255.0))] if k < count else []
        patches = patches.after(images + ([(plane_mm - 10.0, tissue(drawn))] if k < beside else []))
    return patches


def spot(column_mm: float, row_mm: float) -> FloatArray:
    away = (COLUMN - column_mm) ** 2 + (ROW - row_mm) ** 2
    return np.asarray(150.0 * np.exp(-0.5 * away / 1.2**2))


@pytest.mark.parametrize("place_mm", [(0.0, 0.0), (1.0, -0.5), (-4.0, 3.0), (0.0, 7.0)])
def test_a_spot_is_seen_where_it_is(place_mm: tuple[float, float]) -> None:
    found = sighting(beats(spot(*place_mm)))
    assert found is not None
    # to the edge of a spot, which belongs to the tool like its middle
    assert found.off_mm == pytest.approx(max(np.hypot(*place_mm) - 1.2, 0.0), abs=0.7)
    assert found.elsewhere == (np.hypot(*place_mm) > ELSEWHERE_MM + 1.2)
    assert found.beats == 8


def test_a_shaft_in_the_image_ends_where_the_tip_should_be() -> None:
    shaft = np.where(COLUMN > 0, 150.0 * np.exp(-0.5 * (ROW / 1.2) ** 2), 0.0)
    found = sighting(beats(np.asarray(shaft)))
    assert found is not None
    assert not found.elsewhere
    beyond = sighting(beats(np.where(COLUMN > 6.0, shaft, 0.0)))
    assert beyond is not None
    assert beyond.off_mm == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize(("plane_mm", "off_mm"), [(2.0, 0.0), (-4.0, 2.0), (6.0, 4.0)])
def test_a_tool_that_other_planes_show_is_beside_its_place(plane_mm: float, off_mm: float) -> None:
    """By what is more than the thickness of the beam."""
    found = sighting(beats(spot(0.0, 0.0), plane_mm=plane_mm))
    assert found is not None
    assert found.beside_mm == plane_mm
    assert found.off_mm == pytest.approx(off_mm)


def test_echoes_far_from_the_place_are_not_the_tool() -> None:
    assert sighting(beats(spot(0.0, REACH_MM + 4.0))) is None


def test_planes_between_two_steps_count_for_the_nearer() -> None:
    patches, rng = TipPatches.none(), np.random.default_rng(5)
    for _ in range(LEAST_IN_PLANE):
        shown = [(x, tissue(rng) + spot(0.0, 0.0)) for x in (-0.9, 0.4)]
        patches = patches.after([*shown, (9.3, tissue(rng))])
    assert set(patches.beside_mm) == {0.0, 10.0}
    assert sighting(patches) is not None


def test_nothing_is_said_of_a_tool_that_is_not_shown() -> None:
    for seed in range(20):
        assert sighting(beats(np.zeros(ROW.shape), rng=np.random.default_rng(seed))) is None


def test_nothing_is_said_of_too_few_beats() -> None:
    tool = spot(0.0, 0.0)
    assert sighting(beats(tool, count=LEAST_IN_PLANE - 1)) is None
    assert sighting(beats(tool, beside=LEAST_BESIDE - 1)) is None
    assert sighting(beats(tool, count=LEAST_IN_PLANE, beside=LEAST_BESIDE)) is not None


def test_old_beats_are_forgotten() -> None:
    patches = beats(spot(-6.0, 0.0))
    rng = np.random.default_rng(3)
    for _ in range(REMEMBERED_BEATS):
        patches = patches.after([(0.0, tissue(rng) + spot(0.0, 0.0)), (10.0, tissue(rng))])
    found = sighting(patches)
    assert found is not None
    assert not found.elsewhere
    assert (patches.beside_mm == 0.0).sum() == REMEMBERED_BEATS


def test_the_tip_s_place_in_the_image() -> None:
    pixel = np.array([[120.0, 64.0]])
    point = MAP.apply_pixels(pixel).xyz_mm[0] + np.array([0.0, 0.0, 3.0])
    view = tip_view(point, MAP)
    np.testing.assert_allclose(view.pixel, pixel[0])
    assert view.beside_mm == pytest.approx(3.0)


def test_a_patch_has_the_image_around_the_tip_in_mm() -> None:
    rows, columns = np.mgrid[:200, :160]
    # 0.5 mm a column, 0.25 mm a row: grey is mm right of column 80 and mm below row 100
    right, down = 0.5 * (columns - 80.0), 0.25 * (rows - 100.0)
    sector = np.ones((200, 160), dtype=np.bool_)
    view = tip_view(MAP.apply_pixels(np.array([[80.0, 100.0]])).xyz_mm[0], MAP)
    across = patch_around(100.0 + right, sector, view, MAP.scale_mm_per_px)
    along = patch_around(100.0 + down, sector, view, MAP.scale_mm_per_px)
    assert across is not None
    assert along is not None
    np.testing.assert_allclose(across, 100.0 + COLUMN, atol=1e-4)
    np.testing.assert_allclose(along, 100.0 + ROW, atol=1e-4)


def test_outside_the_sector_nothing_is_known() -> None:
    image, sector = np.full((200, 160), 90.0), np.zeros((200, 160), dtype=np.bool_)
    sector[:, :90] = True
    inside = tip_view(MAP.apply_pixels(np.array([[80.0, 100.0]])).xyz_mm[0], MAP)
    patch = patch_around(image, sector, inside, MAP.scale_mm_per_px)
    assert patch is not None
    assert np.isnan(patch[:, COLUMN[0] > 5.0]).all()
    assert np.isfinite(patch[:, COLUMN[0] < 4.0]).all()
    outside = tip_view(MAP.apply_pixels(np.array([[95.0, 100.0]])).xyz_mm[0], MAP)
    assert patch_around(image, sector, outside, MAP.scale_mm_per_px) is None
