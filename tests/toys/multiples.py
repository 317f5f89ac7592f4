"""Trials for the tests of the study machine: in a module of its own, so that other processes can load it."""

import os
import time

from dvf_ig.core import InvalidInputError
from dvf_ig.study.driver import Line, Settings


def multiple(settings: Settings, seed: int) -> Line:
    """Refuses multiples of 5."""
    if seed % 5 == 0:
        raise InvalidInputError(f"seed {seed} is refused")
    return {"value": settings["factor"] * seed}


def whereabouts(settings: Settings, seed: int) -> Line:
    """Takes `seconds`; says which process did it."""
    time.sleep(settings["seconds"])
    return {"process": os.getpid()}


def deadly(settings: Settings, seed: int) -> Line:
    """Ends its process at the seed `deadly`."""
    if seed == settings["deadly"]:
        os._exit(1)
    return {}


def mistaken(settings: Settings, seed: int) -> Line:
    """A mistake in the trial, not a refusal."""
    raise ZeroDivisionError(f"seed {seed}")
