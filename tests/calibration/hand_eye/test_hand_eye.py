"""Hand–eye calibration: exact chains, noise against its covariance, OpenCV's own methods, refusals."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.calibration import (
    HAND_EYE_METHODS,
    Gate,
    HandEyeMethod,
    HandEyeResult,
    accepted,
    calibrate_hand_eye,
)
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, PoseStream, QualityGateError, Rigid

NOISE_MM, NOISE_DEG = 0.2, 0.1


class Bench:
    """A camera on a hand before a still target: the two streams, and what is to be found."""

    def __init__(
        self, seed: int, *, count: int = 40, tilt_deg: float = 35.0, noisy: bool = True, wrong: float = 0.0,
        one_axis: bool = False,
    ) -> None:  # fmt: skip
        rng = np.random.default_rng(seed)
        self.hand_from_camera = Rigid.from_rotation_vector(
            rng.uniform(-1.5, 1.5, 3), rng.uniform(-80, 80, 3), "hand", "camera"
        )
        self.base_from_target = Rigid.from_rotation_vector(
            rng.uniform(-1.5, 1.5, 3), rng.uniform(-500, 500, 3), "base", "target"
        )
        tilts = rng.uniform(-1, 1, (count, 3)) * ([0, 0, 1] if one_axis else [1, 1, 1])
        camera = stacked(
            np.radians(tilt_deg) * tilts, np.array([0, 0, 300]) + rng.uniform(-60, 60, (count, 3))
        )
        hand = (
            self.base_from_target.matrix @ np.linalg.inv(camera) @ np.linalg.inv(self.hand_from_camera.matrix)
        )
        if noisy:
            for poses in (camera, hand):
                poses[:] = poses @ stacked(
                    np.radians(NOISE_DEG) * rng.standard_normal((count, 3)), np.zeros(3)
                )
                poses[:, :3, 3] += NOISE_MM * rng.standard_normal((count, 3))
        self.wrong = rng.permutation(count)[: int(wrong * count)]
        camera[self.wrong, :3, 3] += rng.uniform(10, 60, (len(self.wrong), 3))
        self.t_s = np.arange(count) * 0.2
        self.hand = stream("base", "hand", self.t_s, hand)
        self.camera = stream("camera", "target", self.t_s, camera)

    def solve(self, method: HandEyeMethod = "park") -> HandEyeResult:
        return calibrate_hand_eye(self.hand, self.camera, rng=np.random.default_rng(0), method=method)

    def error(self, found: Rigid) -> FloatArray:
        """(6,) rotation vector in the hand's axes, rad, and shift, mm."""
        rotation = Rotation.from_matrix(found.rotation @ self.hand_from_camera.rotation.T).as_rotvec()
        return np.concatenate([rotation, found.translation_mm - self.hand_from_camera.translation_mm])


def stacked(vectors: FloatArray, shifts: FloatArray) -> FloatArray:
    out = np.tile(np.eye(4), (len(vectors), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = Rotation.from_rotvec(vectors).as_matrix(), shifts
    return out


def stream(target: str, source: str, t_s: FloatArray, poses: FloatArray) -> PoseStream:
    return PoseStream(target, source, t_s, poses[:, :3, :3], poses[:, :3, 3], np.ones(len(t_s), bool))


@pytest.fixture(scope="module")
def solved() -> list[tuple[Bench, HandEyeResult]]:
    """Ten noisy benches and what was found."""
    benches = [Bench(seed) for seed in range(10)]
    return [(bench, bench.solve()) for bench in benches]


@pytest.mark.parametrize("method", HAND_EYE_METHODS)
def test_exact_chains_give_the_exact_answer(method: HandEyeMethod) -> None:
    bench = Bench(1, noisy=False, count=12)
    found = bench.solve(method)
    assert np.abs(bench.error(found.hand_from_camera)).max() < 1e-5
    assert np.allclose(found.base_from_target.matrix, bench.base_from_target.matrix, atol=1e-4)
    assert (found.hand_from_camera.target, found.hand_from_camera.source) == ("hand", "camera")


def test_the_error_is_what_the_covariance_says(solved: list[tuple[Bench, HandEyeResult]]) -> None:
    square = []
    for bench, found in solved:
        error = bench.error(found.hand_from_camera)
        square.append(float(error @ np.linalg.solve(found.covariance, error)))
        assert found.rms_deg == pytest.approx(NOISE_DEG * np.sqrt(2 * 3), rel=0.3)
    # each is chi-squared with 6 degrees of freedom: the mean of ten has an SD of 1.1
    assert 3.0 < np.mean(square) < 10.0


def test_no_closed_form_of_opencv_does_better(solved: list[tuple[Bench, HandEyeResult]]) -> None:
    names = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
    ours: list[float] = []
    theirs: dict[str, list[float]] = {name: [] for name in names}
    for bench, own in solved:
        ours.append(float(np.linalg.norm(bench.error(own.hand_from_camera)[3:])))
        parts = [list(s) for s in (bench.hand.rotations, bench.hand.translations_mm)]
        parts += [list(s) for s in (bench.camera.rotations, bench.camera.translations_mm)]
        for name in names:
            rotation, shift = cv2.calibrateHandEye(*parts, method=getattr(cv2, f"CALIB_HAND_EYE_{name}"))
            found = Rigid("hand", "camera", np.asarray(rotation), np.ravel(shift))
            theirs[name].append(float(np.linalg.norm(bench.error(found)[3:])))
    # the two agree where the noise is small; ten trials tell errors apart to some 15 %
    assert np.mean(ours) < 1.15 * min(np.mean(errors) for errors in theirs.values())
    assert np.mean(ours) < 0.5, "0.2 mm and 0.1 degrees at 300 mm, 40 pairs"


def test_wrong_pairs_are_left_out() -> None:
    bench = Bench(5, wrong=0.3)
    found = bench.solve()
    assert not found.inliers[bench.wrong].any()
    assert found.inliers.sum() >= 24, "of 28 good ones"
    assert np.linalg.norm(bench.error(found.hand_from_camera)[3:]) < 1.0
    assert (found.residuals_mm[bench.wrong] > 5.0).all()


def test_the_hand_is_interpolated_at_the_cameras_times() -> None:
    bench = Bench(2, noisy=False, count=30)
    # a hand that moves along a screw between samples, the camera between them
    t_s = np.arange(0, 20, 0.01)
    vectors = np.column_stack([0.5 * np.sin(0.7 * t_s), 0.5 * np.sin(1.1 * t_s + 1), 0.4 * np.sin(0.5 * t_s)])
    shifts = np.column_stack([40 * np.sin(t_s), 30 * np.cos(0.8 * t_s), 900 + 20 * np.sin(0.6 * t_s)])
    hand = stacked(vectors, shifts)
    camera = np.linalg.inv(hand @ bench.hand_from_camera.matrix) @ bench.base_from_target.matrix
    valid = np.ones(len(t_s), bool)
    valid[500:600] = False
    base_from_hand = PoseStream("base", "hand", t_s[::2], hand[::2, :3, :3], hand[::2, :3, 3], valid[::2])
    seen = stream("camera", "target", t_s[1::20], camera[1::20])
    found = calibrate_hand_eye(base_from_hand, seen, rng=np.random.default_rng(0))
    assert len(found.t_s) < len(seen)
    assert not ((found.t_s > t_s[500]) & (found.t_s < t_s[598])).any(), (
        "lost samples are not interpolated over"
    )
    # chords of 0.02 s miss a rotation of 0.6 rad/s² by 0.6 · 0.02² / 8 = 3e-5 rad, 0.03 mm a metre away
    assert np.abs(bench.error(found.hand_from_camera)[3:]).max() < 0.1
    assert found.rms_mm < 0.1


def test_refusals() -> None:
    with pytest.raises(QualityGateError, match=r"rotates by \d\.\d° only, needed at least 15°"):
        accepted(Bench(0, tilt_deg=3.0).solve())
    assert [why.gate for why in Bench(0, tilt_deg=3.0).solve().refusals] == [Gate.SMALL_ROTATION]
    with pytest.raises(QualityGateError, match="about one axis only"):
        accepted(Bench(0, one_axis=True).solve())
    with pytest.raises(InvalidInputError, match="2 pairs of valid poses; needed at least 3"):
        Bench(0, count=2).solve()
    bench = Bench(0)
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInputError, match="share a frame"):
        calibrate_hand_eye(bench.hand, bench.hand.inverse(), rng=rng)
    shuffled = PoseStream(
        "camera", "target", bench.t_s, bench.camera.rotations[::-1], bench.camera.translations_mm[::-1],
        np.ones(40, bool),
    )  # fmt: skip
    with pytest.raises(QualityGateError, match="pairs agree on one pose of 'camera'"):
        accepted(calibrate_hand_eye(bench.hand, shuffled, rng=rng))
    later = PoseStream(
        "camera", "target", bench.t_s + 1e3, bench.camera.rotations, bench.camera.translations_mm,
        np.ones(40, bool),
    )  # fmt: skip
    with pytest.raises(NoOverlapError, match="record both on one clock"):
        calibrate_hand_eye(bench.hand, later, rng=rng)
    with pytest.raises(InvalidInputError, match="'kabsch' is not one of tsai, park"):
        calibrate_hand_eye(bench.hand, bench.camera, rng=rng, method="kabsch")
