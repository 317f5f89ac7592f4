"""The option that gives the voxel size of an image whose header has lost it."""

from typing import Annotated

import typer
from typer import Option

VoxelOption = Annotated[
    str | None,
    Option(
        "--voxel-mm",
        help="Voxel size where the header has lost it, three numbers of mm, for example 1.5,1.5,10.",
    ),
]


def voxel_size(text: str | None) -> tuple[float, float, float] | None:
    """Parse X,Y,Z.

    Raises:
        typer.BadParameter: another form.
    """
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--voxel-mm is '{text}'; needed three numbers, e.g. 1.5,1.5,10") from None
    return x, y, z
