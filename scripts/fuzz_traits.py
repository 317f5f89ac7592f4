"""Read valid files with one trait of people's files put in (`scripts/fuzz --traits`).

A reader must give the same values, refuse, or warn; what it does instead without a word is a finding.
"""

import dataclasses
import logging
import random
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.errors import DvfIgError
from scripts.traits import ecg, geometry, images

KINDS = (geometry, images, ecg)
TRAITS = {**geometry.TRAITS, **images.TRAITS, **ecg.TRAITS}


def write_trait_seeds(folder: Path) -> None:
    """Write the valid files of all kinds."""
    for kind in KINDS:
        kind.write_seeds(folder)


class _Warnings(logging.Handler):
    """Kinds of warnings: their texts before numbers and names are put in."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.kinds: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        self.kinds.add(str(record.msg))


def _close(one: Any, other: Any) -> bool:
    """Return whether all fields of two values are equal but for rounding."""
    if dataclasses.is_dataclass(one) and not isinstance(one, type):
        return all(_close(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and np.allclose(one, other, rtol=1e-9, atol=1e-12, equal_nan=True)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_close(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_close, one, other))
    return bool(one == other)


def silent_traits(reader: str, seed: int, count: int, folder: Path) -> tuple[list[str], int]:
    """Read `count` files with a trait; list those that are read silently, and count the changed files.

    Args:
        reader: name in TRAITS.
        folder: where `write_trait_seeds` wrote.
    """
    target, warnings, silent, changed = TRAITS[reader], _Warnings(), list[str](), 0
    path, logger = folder / target.file, logging.getLogger("dvf_ig")
    whole = path.read_bytes()
    logger.addHandler(warnings)
    try:
        true = target.read(path)
        usual = frozenset(warnings.kinds)
        for number in range(count):
            rng = random.Random(f"trait {seed} {reader} {number}")
            which = rng.randrange(len(target.traits))
            data = target.traits[which](whole, rng)
            if data == whole:
                continue
            changed += 1
            path.write_bytes(data)
            warnings.kinds.clear()
            try:
                value = target.read(path)
            except DvfIgError:
                continue
            if not warnings.kinds - usual and (target.contradicts or not _close(value, true)):
                silent.append(f"{reader} {number}: trait {which}")
    finally:
        path.write_bytes(whole)
        logger.removeHandler(warnings)
    return silent, changed


def fuzz_traits(readers: list[str], seed: int, count: int, folder: Path) -> int:
    """Print what is read silently, and return how many files are."""
    write_trait_seeds(folder)
    silent_count = 0
    for reader in readers:
        silent, changed = silent_traits(reader, seed, count, folder)
        print(
            "\n".join((*silent, f"{reader}: {changed} files with a trait, {len(silent)} silent")), flush=True
        )
        silent_count += len(silent)
    print(f"{len(readers)} readers, {silent_count} files read silently")
    return silent_count
