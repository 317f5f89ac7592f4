"""The same seed gives the same bits, however many threads do the work."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import concurrent.futures as futures
import dataclasses, hashlib, sys

threads, Pool = int(sys.argv[1]), futures.ThreadPoolExecutor
futures.ThreadPoolExecutor = lambda *_: Pool(threads)

import numpy as np
import data_synth.heart.anatomy as anatomy
import data_synth.mr.cine as cine
from data_synth import PRESETS, ScenarioSpec, phantom_scenario

# a coarse world: the same code at a fraction of the time
outline = anatomy.outline
anatomy.outline = lambda *given: outline(*given, step_mm=12.0)
anatomy.REFERENCE_SPACING_MM = 7.0
Protocol = cine.MrProtocol
cine.MrProtocol = lambda: Protocol(phases=3, spacing_mm=7.0)

def digest(value, into):
    if isinstance(value, np.ndarray):
        into.update(repr((value.shape, str(value.dtype))).encode() + np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            into.update(field.name.encode())
            digest(getattr(value, field.name), into)
    elif isinstance(value, dict):
        digest(tuple(value.items()), into)
    elif isinstance(value, (tuple, list)):
        for part in value:
            digest(part, into)
    else:
        into.update(repr(value).encode())

total = hashlib.sha256()
spec = ScenarioSpec("poor-image", seconds=5.0, us_rate_hz=6.0, seed=11)
digest(phantom_scenario(spec), total)
sys.stdout.write(total.hexdigest())
"""


def digest_with(threads: int) -> str:
    """SHA-256 over every array and value of a short scenario, made in a process of its own."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    paths = os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths, **dict.fromkeys(names, str(threads))}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(threads)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_one_thread_or_two_make_the_same_scenario() -> None:
    """One after the other: the second finds the kernels that the first has compiled."""
    first = digest_with(1)
    assert len(first) == 64
    assert digest_with(2) == first
