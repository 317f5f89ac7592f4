"""Options of studies, which are fields of their settings."""

from dataclasses import MISSING, field
from typing import Any


def option(
    help: str,
    default: Any = MISSING,
    *,
    flag: str | None = None,
    least: float | None = None,
    most: float | None = None,
    argument: bool = False,
) -> Any:
    """A field of a study's settings that is also an option of its command.

    Args:
        help: one sentence.
        default: without one the option is required. A field of type tuple[T, ...] may be given several times.
        flag: "--name"; without one the field's name.
        least, most: of a number.
        argument: given by its position instead.
    """
    about = {"help": help, "flag": flag, "least": least, "most": most, "argument": argument}
    return field(default=default, metadata=about)


def seeds_option(default: int) -> Any:
    """How many seeds a study takes."""
    return option("How many seeds, counted up from --seed; one trial or heart each.", default, least=1)


def seed_option(default: int) -> Any:
    """The first seed of a study."""
    return option("The first seed.", default)
