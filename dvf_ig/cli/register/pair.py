"""`dvf-ig register --fixed US --moving MR`: moving_from_fixed from a pair of images."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.shell import progress

if TYPE_CHECKING:
    from dvf_ig.registration import RegistrationResult
    from dvf_ig.replay.page.registration_page import ShownInput


def register_images(
    fixed: Path | None, moving: list[Path] | None, init: Path | None, mask: Path | None, seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    """Read a pair of images, ultrasound and one or more of MR or CT, and register it."""
    from time import perf_counter

    import numpy as np

    from dvf_ig.core import Rigid
    from dvf_ig.io import read_transform, read_volume
    from dvf_ig.registration import register_pair
    from dvf_ig.replay.page.registration_inputs import pair_shown

    if fixed is None or not moving:
        raise typer.BadParameter("an image pair needs both --fixed US and --moving MR")
    ultrasound = read_volume(fixed, frame="fixed")
    anatomies = [read_volume(path, frame="moving") for path in moving]
    start = (
        read_transform(init, target="moving", source="fixed")
        if init is not None
        else Rigid.identity("moving", "fixed")
    )
    allowed = read_volume(mask, frame="fixed") if mask is not None else None
    with progress("register") as report:
        result = register_pair(
            ultrasound,
            anatomies,
            start,
            rng=np.random.default_rng(seed),
            clock=perf_counter,
            mask=allowed,
            progress=report,
        )
    about = f"fixed {fixed.name}, moving {' and '.join(path.name for path in moving)}"
    return result, pair_shown(result, ultrasound, anatomies[0], about=about)
