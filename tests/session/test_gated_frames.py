"""The probe's pose between noisy samples: nearer to a smooth motion, and left alone if it was jerky."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, PoseStream
from dvf_ig.session.gated_frames import POSES, REACH_MM, smoothed_poses

RATE_HZ = 12.0


def sweep(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A sweep of a hand: 40° and 20 mm to and fro in 9 s, nodding twice as fast."""
    angle = 2 * np.pi * t_s / 9.0
    turns = np.column_stack([0.7 * np.sin(angle), 0.25 * np.sin(2 * angle), 0.1 * np.cos(angle)])
    places = np.column_stack([20 * np.cos(angle), 200 + 10 * np.sin(angle), 5 * np.sin(2 * angle)])
    return Rotation.from_rotvec(turns).as_matrix(), places


def noisy(t_s: FloatArray, *, mm: float, rad: float, valid: FloatArray | None = None) -> PoseStream:
    rng = np.random.default_rng(3)
    rotations, places = sweep(t_s)
    turned = rotations @ Rotation.from_rotvec(rad * rng.normal(size=places.shape)).as_matrix()
    good = np.ones(len(t_s), dtype=np.bool_) if valid is None else np.asarray(valid, dtype=np.bool_)
    return PoseStream("tracker", "probe", t_s, turned, places + mm * rng.normal(size=places.shape), good)


def errors_mm(rotations: FloatArray, places: FloatArray, t_s: FloatArray) -> FloatArray:
    """(n, 2) of the place, and of a turn at the heart."""
    true = sweep(t_s)
    turned = Rotation.from_matrix(np.swapaxes(true[0], 1, 2) @ rotations).magnitude()
    return np.column_stack([np.linalg.norm(places - true[1], axis=1), REACH_MM * turned])


def test_noise_falls_to_less_than_half_and_to_no_more_at_the_ends() -> None:
    stamps = np.arange(0.0, 12.0, 1 / RATE_HZ)
    stream = noisy(stamps, mm=0.6, rad=0.007)
    t_s = np.linspace(0.0, stamps[-1], 400)
    rotations, places, valid = smoothed_poses(stream, t_s)
    assert valid.all()
    found, raw = errors_mm(rotations, places, t_s), errors_mm(*stream.at_many(t_s)[:2], t_s)
    middle = (t_s > 0.6) & (t_s < stamps[-1] - 0.6)
    rms = [
        np.sqrt(np.square(e).mean(axis=0)) for e in (found[middle], raw[middle], found[~middle], raw[~middle])
    ]
    assert (rms[0] < 0.55 * rms[1]).all()
    assert (rms[2] < 1.1 * rms[3]).all()


def test_a_clean_sweep_stays_where_it_is() -> None:
    stamps = np.arange(0.0, 9.0, 1 / RATE_HZ)
    t_s = np.linspace(0.5, 8.0, 200)
    rotations, places, _ = smoothed_poses(noisy(stamps, mm=0.0, rad=0.0), t_s)
    raw = noisy(stamps, mm=0.0, rad=0.0).at_many(t_s)
    assert errors_mm(rotations, places, t_s).max() <= errors_mm(raw[0], raw[1], t_s).max() + 1e-9


def test_a_sudden_move_is_not_rounded_off() -> None:
    stamps = np.arange(0.0, 6.0, 1 / RATE_HZ)
    stream = noisy(stamps, mm=0.1, rad=0.0)
    moved = stream.translations_mm + np.where(stamps > 3.0, 15.0, 0.0)[:, None]
    jerky = PoseStream("tracker", "probe", stamps, stream.rotations, moved, stream.valid)
    near = stamps[(stamps > 2.6) & (stamps < 3.4)]
    np.testing.assert_allclose(smoothed_poses(jerky, near)[1], jerky.at_many(near)[1])


def test_what_is_not_known_is_not_made_up() -> None:
    stamps = np.arange(0.0, 6.0, 1 / RATE_HZ)
    valid = np.ones(len(stamps), dtype=np.bool_)
    valid[30:40] = False
    stream = noisy(stamps, mm=0.3, rad=0.0, valid=valid)
    t_s = np.linspace(0.0, 6.5, 300)
    rotations, places, known = smoothed_poses(stream, t_s)
    raw = stream.at_many(t_s)
    np.testing.assert_array_equal(known, raw[2])
    np.testing.assert_array_equal(places[~known], 0.0)
    np.testing.assert_array_equal(rotations[~known], np.eye(3)[None].repeat((~known).sum(), axis=0))


@pytest.mark.parametrize("count", [1, POSES - 1])
def test_too_few_samples_are_taken_as_they_are(count: int) -> None:
    stamps = np.arange(count) / RATE_HZ
    stream = noisy(stamps, mm=0.5, rad=0.01)
    for found, raw in zip(smoothed_poses(stream, stamps), stream.at_many(stamps), strict=True):
        np.testing.assert_array_equal(found, raw)


def test_a_pose_does_not_depend_on_samples_outside_its_window() -> None:
    """A long recording gives the same as the part for one beat."""
    stamps = np.arange(0.0, 12.0, 1 / RATE_HZ)
    stream = noisy(stamps, mm=0.6, rad=0.007)
    part = slice(60, 80)
    short = PoseStream(
        "tracker",
        "probe",
        stamps[part],
        stream.rotations[part],
        stream.translations_mm[part],
        stream.valid[part],
    )
    t_s = stamps[68:73] + 0.01
    for whole, alone in zip(smoothed_poses(stream, t_s), smoothed_poses(short, t_s), strict=True):
        np.testing.assert_allclose(whole, alone, atol=1e-12)
