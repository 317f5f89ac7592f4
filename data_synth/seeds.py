"""Independent random generators, one per named stream of the synthetic world."""

import zlib

import numpy as np


def child_rng(seed: int, name: str) -> np.random.Generator:
    """Create the generator of stream `name` under `seed`.

    The name, not the order of use, selects the stream: adding one stream never changes another.
    """
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))


def child_seed(seed: int, name: str) -> int:
    """Derive a non-negative 31-bit seed of stream `name`, for interfaces that take a number."""
    return int(child_rng(seed, name).integers(0, 2**31 - 1))
