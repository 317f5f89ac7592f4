"""Image pairs whose registration is known: the truth holds, and every stated disturbance is there."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import data_synth.scenario.image_pair as image_pair_module
from data_synth.heart.anatomy import PhantomAnatomy, _at_rest, phantom_anatomy
from data_synth.heart.heart_spec import STANDARD_HEART, HeartSpec
from data_synth.heart.tissue import Tissue
from data_synth.scenario.image_pair import (
    BEATS_PER_VOLUME,
    DEFORMATION_MM,
    JITTER,
    PART_SHARE,
    ImagePair,
    Jitter,
    PairSpec,
    Quality,
    image_pair,
)
from data_synth.ultrasound.image_faults import ImageSpec
from data_synth.ultrasound.volume import MatrixProbe
from dvf_ig.core import FloatArray, InvalidInputError, Rigid, TrackedVolume, Volume

ARRAY = MatrixProbe(sector=replace(MatrixProbe().sector, lines=24, samples=128), tall=24, voxel_mm=2.0)
SYSTOLE = 0.375
"""Exact in binary, as phase errors are here: a phase reached by two ways is the same number."""


@pytest.fixture(scope="module", autouse=True)
def _hearts_once(anatomy: PhantomAnatomy) -> Iterator[None]:
    """Each heart is made once, and that of the folder's fixture not again."""

    @lru_cache
    def once(**spec: Any) -> PhantomAnatomy:
        known = {"motion": "physiological", "mismatch_mm": 1.2, "seed": 1, "heart": STANDARD_HEART}
        return anatomy if spec == known else phantom_anatomy(**spec)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(image_pair_module, "phantom_anatomy", once)
        yield


@pytest.fixture(scope="module")
def pair() -> ImagePair:
    return image_pair(PairSpec(1, motion="physiological"))


def same(first: TrackedVolume, second: TrackedVolume) -> bool:
    return np.array_equal(first.image.values, second.image.values) and np.array_equal(
        first.tracker_from_image.matrix, second.tracker_from_image.matrix
    )


def test_other_speckle_leaves_heart_and_poses_alone(pair: ImagePair) -> None:
    other = replace(pair, spec=replace(pair.spec, heart=HeartSpec(speckle_seed=2)))
    for first, second in zip(
        pair.volumes([0.0], probe=ARRAY), other.volumes([0.0], probe=ARRAY), strict=True
    ):
        assert not np.array_equal(first.image.values, second.image.values)
        one, two = first.tracker_from_image, second.tracker_from_image
        np.testing.assert_array_equal(one.matrix, two.matrix)


def test_the_same_spec_gives_the_same_bits(pair: ImagePair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_pair_module, "phantom_anatomy", phantom_anatomy)
    _at_rest.cache_clear()  # made again, not remembered
    fresh = image_pair(pair.spec)
    np.testing.assert_array_equal(fresh.now.ed_vertices_mm, pair.now.ed_vertices_mm)
    again = replace(fresh, now=pair.now)  # its tissue map takes seconds to build
    np.testing.assert_array_equal(again.mr_from_tracker.matrix, pair.mr_from_tracker.matrix)
    np.testing.assert_array_equal(again.targets.points.xyz_mm, pair.targets.points.xyz_mm)
    first, second = pair.volumes([0.0], probe=ARRAY), again.volumes([0.0], probe=ARRAY)
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


def test_other_seeds_are_other_hearts_and_trackers(pair: ImagePair) -> None:
    other = image_pair(replace(pair.spec, seed=8))
    turn = Rotation.from_matrix(other.mr_from_tracker.rotation @ pair.mr_from_tracker.rotation.T)
    assert turn.magnitude() > 0.1
    shift = other.mr_from_tracker.translation_mm - pair.mr_from_tracker.translation_mm
    assert np.linalg.norm(shift) > 1.0
    assert np.abs(other.targets.points.xyz_mm - pair.targets.points.xyz_mm).max() > 1.0


def wall_over_blood(pair: ImagePair, volume: TrackedVolume, offset_mm: FloatArray) -> float:
    """Mean grey of the muscle less that of the blood of the left ventricle, at places mapped by the truth."""
    seen = volume.mask.values > 0
    grey = volume.image.values[seen].astype(np.float64)[::6]
    at = (pair.mr_from_tracker @ volume.tracker_from_image).apply_array(volume.image.grid.centers_mm()[seen])
    tissue = pair.now.tissue(np.ascontiguousarray(at[::6] + offset_mm), volume.model_phase)
    return float(grey[tissue == Tissue.LV_MYOCARDIUM].mean() - grey[tissue == Tissue.LV_BLOOD].mean())


def test_volumes_are_where_the_truth_says(pair: ImagePair, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blood is dark and wall bright at the mapped places, and less so at places a few mm aside."""
    monkeypatch.setitem(JITTER, "calm", Jitter(0.0, 0.0))
    volumes = pair.volumes([SYSTOLE], probe=ARRAY)
    assert [v.model_phase for v in volumes] == [SYSTOLE] * 2
    assert {v.tracker_from_image.target for v in volumes} == {"tracker"}

    def contrast(offset_mm: FloatArray) -> float:
        return float(np.mean([wall_over_blood(pair, v, offset_mm) for v in volumes]))

    here = contrast(np.zeros(3))
    assert here > 35.0, "27 dB between blood and muscle, blurred by a coarse beam, of 255 levels in 60 dB"
    for axis in np.eye(3):
        ahead, behind = contrast(6.0 * axis), contrast(-6.0 * axis)
        assert max(ahead, behind) < here
        # a parabola through the three has its top at the truth, to within the beam's and the fit's width
        top_mm = 6.0 * (ahead - behind) / (2.0 * (2.0 * here - ahead - behind))
        assert abs(top_mm) < 1.5


@pytest.fixture
def without_images(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """Pairs make poses but black images; records what the simulator was asked for."""
    asked: dict[str, list[Any]] = {"poses": [], "times": [], "specs": []}
    grid = ARRAY.grid
    black = Volume(grid, np.zeros(grid.shape, dtype=np.uint8))

    def pyramid(anatomy: Any, probe: Any, mr_from_plane: Rigid, times: FloatArray, **_: Any) -> FloatArray:
        asked["poses"].append(mr_from_plane)
        asked["times"].append(times)
        return np.zeros(1)

    def degraded(level: FloatArray, probe: Any, spec: ImageSpec, rng: Any) -> FloatArray:
        asked["specs"].append((spec, probe.sector.dynamic_range_db))
        return level

    monkeypatch.setattr(image_pair_module, "simulate_pyramid", pyramid)
    monkeypatch.setattr(image_pair_module, "degraded_pyramid", degraded)
    monkeypatch.setattr(
        image_pair_module, "shown_volume", lambda *_: SimpleNamespace(image=black, mask=black)
    )
    return asked


def with_quality(pair: ImagePair, quality: Quality) -> ImagePair:
    return replace(pair, spec=replace(pair.spec, quality=quality))


def jitter_of(pair: ImagePair, read: list[Rigid], true: list[Rigid]) -> tuple[float, float]:
    """RMS 3-D position in mm and RMS angle in degrees of read poses."""
    tracker_from_mr = pair.mr_from_tracker.inverse()
    steps = [(tracker_from_mr @ t).inverse() @ r for t, r in zip(true, read, strict=True)]
    shift = np.array([s.translation_mm for s in steps])
    turn = Rotation.from_matrix(np.array([s.rotation for s in steps])).magnitude()
    return float(np.sqrt((shift**2).sum(axis=1).mean())), float(np.rad2deg(np.sqrt((turn**2).mean())))


@pytest.mark.parametrize("quality", ["calm", "poor-image"])
def test_a_volume_is_read_once_a_beat(
    pair: ImagePair, quality: Quality, without_images: dict[str, list[Any]]
) -> None:
    noisy = with_quality(pair, quality)
    made = noisy.volumes(list(np.arange(500) / 500), probe=ARRAY)
    found = jitter_of(noisy, [v.tracker_from_image for v in made], without_images["poses"])
    stated, mean = JITTER[quality], np.sqrt(BEATS_PER_VOLUME)
    assert found == pytest.approx((stated.position_mm / mean, stated.rotation_deg / mean), rel=0.05)


def test_every_phase_of_a_view_is_seen_from_one_place(
    pair: ImagePair, without_images: dict[str, list[Any]]
) -> None:
    made = pair.volumes([0.0, 0.25, 0.75], probe=ARRAY)
    assert [v.model_phase for v in made] == [0.0, 0.25, 0.75] * 2
    poses = [p.matrix for p in without_images["poses"]]
    for first in (0, 3):
        for other in (1, 2):
            np.testing.assert_array_equal(poses[first], poses[first + other])
    assert np.abs(poses[0] - poses[3]).max() > 1.0


def test_parts_of_a_volume_are_taken_about_the_gate(
    pair: ImagePair, without_images: dict[str, list[Any]]
) -> None:
    pair.volumes([0.5], phase_error=-0.125, probe=ARRAY)
    times = without_images["times"][0]
    assert times.shape == (ARRAY.tall, ARRAY.sector.lines)
    np.testing.assert_allclose(times.mean(), 0.375, atol=1e-12)
    parts = times[:, 0].reshape(BEATS_PER_VOLUME, -1)
    np.testing.assert_allclose(parts, np.tile(parts[0], (BEATS_PER_VOLUME, 1)), atol=1e-15)
    assert 0.5 * PART_SHARE < np.ptp(parts[0]) < PART_SHARE
    assert (np.diff(parts[0]) > 0).all()


def test_a_late_gate_shows_a_later_phase_under_the_same_name(pair: ImagePair) -> None:
    late = pair.volumes([0.0, 0.5], phase_error=[SYSTOLE, 0.0], probe=ARRAY)
    true = pair.volumes([SYSTOLE, 0.5], probe=ARRAY)
    all_late = pair.volumes([0.25, 0.75], phase_error=0.125, probe=ARRAY)
    other = pair.volumes([SYSTOLE, 0.875], probe=ARRAY)
    assert [v.model_phase for v in late] == [0.0, 0.5] * 2
    assert [v.model_phase for v in all_late] == [0.25, 0.75] * 2
    assert all(same(a, b) for a, b in zip((*late, *all_late), (*true, *other), strict=True))
    assert not np.array_equal(late[0].image.values, late[1].image.values)


def test_poor_images_get_the_faults_of_their_preset(
    pair: ImagePair, without_images: dict[str, list[Any]]
) -> None:
    for quality in ("no-mismatch", "calm", "poor-image"):
        with_quality(pair, quality).volumes([0.0], probe=ARRAY)
    faults = [(s.clutter, s.shadows, shown_db) for s, shown_db in without_images["specs"]]
    assert faults == [(0.0, 0, 60.0)] * 4 + [(5.0, 3, 45.0)] * 2


def test_changes_do_what_they_say(pair: ImagePair) -> None:
    spec = replace(pair.spec, quality="no-mismatch")
    still = image_pair(spec)
    deformed = image_pair(replace(spec, change="deformation"))
    motion = image_pair(replace(spec, quality="calm", change="motion"))
    for changed in (deformed, motion):
        assert changed.before.mismatch.rms_mm == 0
        np.testing.assert_array_equal(changed.before.ed_vertices_mm, pair.before.ed_vertices_mm)
        np.testing.assert_array_equal(changed.mr_from_tracker.matrix, pair.mr_from_tracker.matrix)

    def moved_mm(now: PhantomAnatomy, phase: float) -> FloatArray:
        before = pair.before.surface_vertices(phase)
        return np.asarray(np.linalg.norm(now.surface_vertices(phase) - before, axis=1))

    assert moved_mm(still.now, 0.3).max() == 0
    for changed, stated in ((motion, 1.2), (deformed, DEFORMATION_MM)):
        assert changed.now.mismatch.rms_mm == stated
        # stated over the heart's box; the surface lies further out than most of it
        assert 0.7 * stated < np.sqrt((moved_mm(changed.now, 0.0) ** 2).mean()) < 1.8 * stated
    ends = [np.asarray(a.surface_vertices(SYSTOLE)) for a in (pair.before, motion.now)]
    starts = [np.asarray(a.surface_vertices(0.0)) for a in (pair.before, motion.now)]
    stroke = [float(np.linalg.norm(e - s, axis=1).max()) for s, e in zip(starts, ends, strict=True)]
    assert stroke == pytest.approx([13.9, 5.0], rel=0.15), "what the two motions are named for"


def test_impossible_pairs_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="non-negative seed"):
        PairSpec(-1)
    with pytest.raises(InvalidInputError, match="no-mismatch, calm, poor-image"):
        PairSpec(1, quality="excellent")
