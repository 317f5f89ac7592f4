"""Traits that people reported of their own files, put into valid ones, by kind of file."""

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Trait = Callable[[bytes, random.Random], bytes]
"""Change of a file's bytes; a file that stays the same shows that the trait does not apply to it."""


@dataclass(frozen=True, slots=True)
class Target:
    """A valid file, its reader, and what may be wrong with it.

    Attributes:
        file: path in the folder of valid files.
        read: returns the values that must stay the same.
        contradicts: whether each trait contradicts the rest of the file, which must not be read without a
            word even if the values stay the same.
    """

    file: str
    read: Callable[[Path], Any]
    traits: tuple[Trait, ...]
    contradicts: bool = False


def in_text(change: Callable[[str, random.Random], str]) -> Trait:
    """Make a trait of a change of text."""
    return lambda data, rng: change(data.decode("latin-1"), rng).encode("latin-1")


def in_lines(change: Callable[[list[str], random.Random], None]) -> Trait:
    """Make a trait of a change of the list of lines, the last of which is empty."""

    def trait(text: str, rng: random.Random) -> str:
        lines = text.split("\n")
        change(lines, rng)
        return "\n".join(lines)

    return in_text(trait)


def in_cells(change: Callable[[list[list[str]], random.Random], None]) -> Trait:
    """Make a trait of a change of a table's rows of cells, the first of which has the names."""

    def trait(text: str, rng: random.Random) -> str:
        rows = [line.split(",") for line in text.splitlines()]
        change(rows, rng)
        return "\n".join(map(",".join, rows)) + "\n"

    return in_text(trait)


def drop_cell(rows: list[list[str]], rng: random.Random) -> None:
    """Drop a cell of a row."""
    row = rng.choice(rows[1:])
    del row[rng.randrange(len(row))]


def swap_columns(rows: list[list[str]], rng: random.Random) -> None:
    """Exchange two columns, names and values."""
    i, j = rng.sample(range(len(rows[0])), 2)
    for row in rows:
        row[i], row[j] = row[j], row[i]


def replaced(*pairs: tuple[str, str]) -> Trait:
    """Replace the first occurrence of one text by another."""

    def trait(text: str, rng: random.Random) -> str:
        old, new = rng.choice(pairs)
        return text.replace(old, new, 1)

    return in_text(trait)


def substituted(pattern: str, *texts: str) -> Trait:
    """Replace one match of a pattern."""

    def trait(text: str, rng: random.Random) -> str:
        matches = list(re.finditer(pattern, text, re.MULTILINE))
        if not matches:
            return text
        match = rng.choice(matches)
        return text[: match.start()] + match.expand(rng.choice(texts)) + text[match.end() :]

    return in_text(trait)
