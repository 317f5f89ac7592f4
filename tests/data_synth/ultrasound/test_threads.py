"""The same seed gives the same bits, however many threads do the work."""

import dataclasses
import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_synth import ScenarioSpec, phantom_scenario
from data_synth.heart import anatomy
from data_synth.heart.outline import outline
from data_synth.mr.cine import MrProtocol


def add(value: Any, into: Any) -> None:
    if isinstance(value, np.ndarray):
        into.update(repr((value.shape, str(value.dtype))).encode() + np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            into.update(field.name.encode())
            add(getattr(value, field.name), into)
    elif isinstance(value, dict):
        add(tuple(value.items()), into)
    elif isinstance(value, tuple | list):
        for part in value:
            add(part, into)
    else:
        into.update(repr(value).encode())


def scenario_digest(threads: int) -> str:
    """SHA-256 over every array and value of a short scenario of a coarse world."""
    total = hashlib.sha256()
    anatomy._at_rest.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("data_synth.threads.ThreadPoolExecutor", lambda *_: ThreadPoolExecutor(threads))
        patch.setattr(anatomy, "outline", partial(outline, step_mm=12.0))
        patch.setattr(anatomy, "REFERENCE_SPACING_MM", 7.0)
        patch.setattr("data_synth.mr.cine.MrProtocol", lambda: MrProtocol(phases=3, spacing_mm=7.0))
        add(phantom_scenario(ScenarioSpec("poor-image", seconds=5.0, us_rate_hz=6.0, seed=11)), total)
    anatomy._at_rest.cache_clear()  # no other test meets the coarse heart
    return total.hexdigest()


def test_one_thread_or_two_make_the_same_scenario() -> None:
    """The two, also of BLAS, are in a process of their own."""
    here = scenario_digest(1)
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    paths = os.pathsep.join([str(Path(__file__).parents[3]), *sys.path])
    code = "from tests.data_synth.ultrasound.test_threads import scenario_digest; print(scenario_digest(2))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths, **dict.fromkeys(names, "2")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == here
