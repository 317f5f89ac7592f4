"""Conjugate gradients: SciPy's answer, sums of one order, and each way to end."""

import hashlib
import inspect
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, cg

from dvf_ig.core import Stop
from dvf_ig.preop import conjugate_gradients


def system(n=400, seed=3):
    """A badly scaled positive definite matrix and a right-hand side."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(n, n)) / np.sqrt(n)
    scale = np.diag(10.0 ** rng.uniform(-1.0, 1.0, n))
    return scale @ (factor @ factor.T + 0.1 * np.eye(n)) @ scale, rng.normal(size=n)


def solve(a, b, tolerance=1e-10, max_iterations=2000, **more):
    diagonal = a.diagonal()
    return conjugate_gradients(
        lambda x: a @ x, b, lambda r: r / diagonal, tolerance=tolerance, max_iterations=max_iterations, **more
    )


def test_it_agrees_with_scipy_and_with_the_direct_solution():
    a, b = system()
    found = solve(a, b)
    jacobi = LinearOperator(a.shape, lambda r: r / a.diagonal(), dtype=np.float64)
    theirs, failed = cg(a, b, rtol=1e-12, M=jacobi)
    assert found.stop is Stop.CONVERGED
    assert failed == 0
    exact = np.linalg.solve(a, b)
    np.testing.assert_allclose(found.x, theirs, rtol=0, atol=1e-8 * np.abs(exact).max())
    np.testing.assert_allclose(found.x, exact, rtol=0, atol=1e-8 * np.abs(exact).max())


def test_it_takes_as_many_steps_as_scipy_on_the_scaled_system():
    """With D^-1/2 A D^-1/2 the Euclidean residual, which SciPy tests, is the preconditioned one."""
    a, b = system()
    root = np.sqrt(a.diagonal())
    steps: list[np.ndarray] = []
    cg(a / root / root[:, None], b / root, rtol=1e-6, callback=steps.append)
    assert solve(a, b, tolerance=1e-6).iterations == pytest.approx(len(steps), abs=1)


def test_arrays_of_any_shape_and_every_step_is_reported():
    a, b = system(24)
    steps: list[np.ndarray] = []
    flat = solve(a, b, on_iteration=steps.append)
    whole = conjugate_gradients(
        lambda x: (a @ x.ravel()).reshape(2, 3, 4),
        b.reshape(2, 3, 4),
        lambda r: r / a.diagonal().reshape(2, 3, 4),
        tolerance=1e-10,
        max_iterations=2000,
    )
    assert len(steps) == flat.iterations
    np.testing.assert_array_equal(steps[-1], flat.x)
    np.testing.assert_allclose(whole.x.ravel(), flat.x, rtol=1e-6)


def test_the_limit_of_steps_is_said():
    a, b = system()
    cut = solve(a, b, max_iterations=3)
    assert cut.stop is Stop.MAX_ITERATIONS
    assert cut.iterations == 3
    assert solve(a, np.zeros(len(b))).iterations == 0


def bits():
    rng = np.random.default_rng(0)
    d, b = 1.0 + rng.uniform(size=200_000), rng.normal(size=200_000)
    x = conjugate_gradients(lambda x: d * x, b, lambda r: r, tolerance=1e-12, max_iterations=30).x
    return hashlib.sha256(x.tobytes()).hexdigest()


def test_the_same_bits_at_any_number_of_blas_threads():
    """BLAS' inner product, which SciPy's solver uses, has other bits with two threads than with one."""
    imports = "import hashlib, numpy as np\nfrom dvf_ig.preop import conjugate_gradients\n"
    other = "2" if os.environ.get("OPENBLAS_NUM_THREADS") == "1" else "1"
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}{inspect.getsource(bits)}print(bits())"],
        env=dict(os.environ, OPENBLAS_NUM_THREADS=other),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == bits()
