"""Composition: forbidden before guidance, bounded, continuous, without order; conflicts are reported."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from dvf_ig.core import FrameMismatchError, InvalidInputError
from dvf_ig.guidance import Contribution, compose
from dvf_ig.guidance.composition import without_inward_part

CAP = 0.6
seeds = st.integers(0, 2**32 - 1)


def drawn(rng, count, cap=CAP):
    """Contributions of random directions and activation, now and then none or full."""
    out = []
    for _ in range(count):
        direction = rng.normal(size=3)
        share = rng.choice([0.0, 1.0, rng.uniform(), rng.uniform()])
        out.append(Contribution("mr", cap * share * direction / np.linalg.norm(direction), cap))
    return out


def nudged(rng, contributions, step):
    """The same, each force moved by at most `step` and kept within its cap."""
    out = []
    for c in contributions:
        direction = rng.normal(size=3)
        force = c.force_n + step * rng.uniform() * direction / np.linalg.norm(direction)
        out.append(
            Contribution("mr", force * min(1.0, c.cap_n / max(np.linalg.norm(force), 1e-300)), c.cap_n)
        )
    return out


def by_least_squares(force, contributions):
    """The minimiser of ½|x − F|² + ½ Σ f/(1−f) max(0, x·n)² as a non-negative least-squares problem."""
    acting = [c for c in contributions if c.activation > 0.0]
    activation = np.array([c.activation for c in acting])
    inward = np.stack([-c.force_n / np.linalg.norm(c.force_n) for c in acting], axis=1)
    columns = inward * np.sqrt(activation)
    matrix = np.vstack([columns, np.diag(np.sqrt(1.0 - activation))])
    scaled, _ = nnls(matrix, np.concatenate([force, np.zeros(len(acting))]))
    return force - columns @ scaled


@given(seeds, st.integers(1, 6))
def test_the_kernel_is_the_least_squares_solution(seed, count):
    rng = np.random.default_rng(seed)
    walls = [w for w in drawn(rng, count) if w.activation > 0.0]
    if count % 2 and len(walls) > 1:
        walls[1] = Contribution("mr", rng.choice([-1.0, 1.0]) * walls[0].force_n, CAP)
    if walls:
        force = rng.normal(size=3)
        np.testing.assert_allclose(
            without_inward_part(force, walls), by_least_squares(force, walls), atol=1e-12
        )


def test_one_region_rejects_the_theory_s_share_of_the_inward_part():
    """F_g − f·max(0, F_g·n)·n with n into the region, f its activation."""
    inward = np.array([0.0, 0.6, -0.8])
    for f in (0.0, 0.25, 0.5, 0.99, 1.0):
        wall = Contribution("mr", -f * CAP * inward, CAP)
        leading_in, leading_out = np.array([0.3, 0.1, -0.2]), np.array([0.3, -0.1, 0.2])
        expected = leading_in - f * (leading_in @ inward) * inward
        np.testing.assert_allclose(without_inward_part(leading_in, [wall]), expected, atol=1e-12)
        np.testing.assert_allclose(without_inward_part(leading_out, [wall]), leading_out, atol=1e-12)


def test_two_parallel_regions_do_not_take_twice():
    """With n₁ = n₂ the penalties add: w = 2f/(1−f), so the share taken is w/(1+w)."""
    inward, f = np.array([1.0, 0.0, 0.0]), 0.5
    walls = [Contribution("mr", -f * CAP * inward, CAP)] * 2
    got = without_inward_part(np.array([0.3, 0.1, 0.0]), walls)
    np.testing.assert_allclose(got, [0.3 * (1 - 2 / 3), 0.1, 0.0], atol=1e-12)


@given(seeds, st.integers(1, 4))
def test_full_activation_rejects_all_that_leads_in(seed, count):
    rng = np.random.default_rng(seed)
    inward = rng.normal(size=(count, 3))
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    force = rng.normal(size=3)
    left = without_inward_part(force, [Contribution("mr", -CAP * n, CAP) for n in inward])
    assert (inward @ left).max() <= 1e-9
    assert np.linalg.norm(left) <= np.linalg.norm(force) * (1 + 1e-12)


@given(seeds)
def test_opposing_walls_leave_the_slide_between_them(seed):
    rng = np.random.default_rng(seed)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    force = rng.normal(size=3)
    left = without_inward_part(force, [Contribution("mr", -CAP * n, CAP), Contribution("mr", CAP * n, CAP)])
    np.testing.assert_allclose(left, force - (force @ n) * n, atol=1e-9)


@given(seeds, st.integers(0, 3), st.integers(0, 3))
def test_bounded_and_the_sum_of_its_parts(seed, walls, guides):
    rng = np.random.default_rng(seed)
    forbidden, guidance = drawn(rng, walls), drawn(rng, guides)
    out = compose(forbidden, guidance, frame="mr", cap_n=CAP)
    assert np.linalg.norm(out.force_n) <= CAP * (1 + 1e-12)
    np.testing.assert_allclose(out.force_n, out.forbidden_n + out.guidance_n, atol=1e-15)
    if forbidden:
        total = np.sum([c.force_n for c in forbidden], axis=0)
        share = min(1.0, CAP / max(float(np.linalg.norm(total)), 1e-300))
        np.testing.assert_allclose(out.forbidden_n, share * total, atol=1e-12)


@given(seeds)
def test_order_within_a_class_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    forbidden, guidance = drawn(rng, 3), drawn(rng, 3)
    one = compose(forbidden, guidance, frame="mr", cap_n=CAP)
    other = compose(forbidden[::-1], guidance[1:] + guidance[:1], frame="mr", cap_n=CAP)
    assert np.array_equal(one.force_n, other.force_n)
    assert one.conflict == other.conflict


@given(seeds, st.integers(0, 3), st.integers(0, 3))
def test_continuous(seed, walls, guides):
    """A nudge of ε in every force moves the composed one by a bounded multiple of ε.

    One wall: 3ε from guidance; a wall's f changes by ε/cap and its n turns by ε/(f·cap), which moves at most
    f·|F_g| <= 3f·cap by thrice that, 9ε; ε each from the push and from its room. Two walls that nearly face
    each other leave a narrow wedge, whose direction turns faster by one over its angle.
    """
    rng = np.random.default_rng(seed)
    forbidden, guidance = drawn(rng, walls), drawn(rng, guides)
    step = 1e-6
    here = compose(forbidden, guidance, frame="mr", cap_n=CAP).force_n
    there = compose(nudged(rng, forbidden, step), nudged(rng, guidance, step), frame="mr", cap_n=CAP).force_n
    assert np.linalg.norm(there - here) <= (14 if walls < 2 else 1000) * step


def test_guidance_is_shortened_before_a_forbidden_region_s_push():
    wall = Contribution("mr", np.array([0.5, 0.0, 0.0]), CAP)
    guide = Contribution("mr", np.array([0.0, 0.6, 0.0]), CAP)
    out = compose([wall], [guide], frame="mr", cap_n=CAP)
    np.testing.assert_allclose(out.force_n, [0.5, 0.1, 0.0])
    assert out.saturated
    assert not out.conflict


def test_conflicts_are_reported():
    wall = Contribution("mr", np.array([0.54, 0.0, 0.0]), CAP)
    into = Contribution("mr", np.array([-0.5, 0.0, 0.0]), CAP)
    assert compose([wall], [into], frame="mr", cap_n=CAP).conflict
    np.testing.assert_allclose(
        compose([wall], [into], frame="mr", cap_n=CAP).rejected_n, [-0.45, 0.0, 0.0], atol=1e-12
    )
    opposite = Contribution("mr", np.array([-0.5, 0.1, 0.0]), CAP)
    assert compose([wall, opposite], [], frame="mr", cap_n=CAP).conflict
    assert not compose(
        [wall], [Contribution("mr", np.array([0.0, 0.5, 0.0]), CAP)], frame="mr", cap_n=CAP
    ).conflict
    faint = [Contribution("mr", np.array([x, 0.0, 0.0]), CAP) for x in (0.02, -0.02)]
    assert not compose(faint, [], frame="mr", cap_n=CAP).conflict


def test_nothing_composes_to_nothing():
    out = compose([], [], frame="mr", cap_n=CAP)
    assert not out.force_n.any()
    assert not out.conflict
    assert not out.saturated


def test_senseless_numbers_are_refused():
    with pytest.raises(InvalidInputError, match=r"0\.7 N exceeds its own cap of 0\.6 N"):
        Contribution("mr", np.array([0.7, 0.0, 0.0]), CAP)
    with pytest.raises(InvalidInputError, match="cap is 0 N"):
        Contribution("mr", np.zeros(3), 0.0)
    with pytest.raises(InvalidInputError, match="non-finite"):
        Contribution("mr", np.array([np.nan, 0.0, 0.0]), CAP)
    with pytest.raises(InvalidInputError, match="composed cap"):
        compose([], [], frame="mr", cap_n=-1.0)


def test_fixtures_in_different_frames_are_refused():
    wall, guide = Contribution("mr", [0.1, 0, 0], CAP), Contribution("tracker", [0, 0.1, 0], CAP)
    assert compose([wall], [], frame="mr", cap_n=CAP).frame == "mr"
    with pytest.raises(FrameMismatchError, match="composed fixtures: needed frame 'mr', got frame 'tracker'"):
        compose([wall], [guide], frame="mr", cap_n=CAP)
