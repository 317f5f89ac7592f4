"""The blood-filled chambers of a model: from labels of every phase, or from surfaces known by their names."""

import logging
from collections.abc import Iterable, Sequence

from dvf_ig.core import Chamber, InvalidInputError, Mesh, SurfaceSeries, VolumeSeries
from dvf_ig.core.progress import thread_pool

from .closing import close_surface
from .from_labels import surface_of_mask

log = logging.getLogger(__name__)

CHAMBER_SURFACES = ("LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
"""Names of surfaces that enclose blood."""


def chambers_from_surfaces(surfaces: Iterable[SurfaceSeries]) -> tuple[Chamber, ...]:
    """Close the surfaces whose name is one of CHAMBER_SURFACES; skip all others.

    Raises:
        InvalidInputError: a surface that cannot be closed.
    """
    return tuple(chamber_of(close_surface(s)) for s in surfaces if s.name in CHAMBER_SURFACES)


def chamber_of(series: SurfaceSeries) -> Chamber:
    """Close a surface series and make it a chamber."""
    return Chamber(series.name, tuple(series.phase(i) for i in range(len(series.timing))))


def chambers_from_labels(
    labels: VolumeSeries, values: Sequence[int], names: dict[int, str], *, threads: int = 2
) -> tuple[Chamber, ...]:
    """Extract the surface of each label of blood, phase by phase.

    A label that is missing in a phase gives no chamber; a warning is logged.

    Args:
        values: labels of blood.
        names: names of labels; without one, label 3 is called "label 3".
        threads: phases at a time; has no influence on the result.
    """
    chambers = []
    with thread_pool(threads) as pool:
        for value in values:
            name = label_name(value, names)
            try:
                meshes = tuple(pool.map(lambda phase, v=value: _surface(labels, phase, v), _phases(labels)))
            except InvalidInputError as error:
                log.warning("%s is left out of the blood chambers: %s", name, error)
            else:
                chambers.append(Chamber(name, meshes))
    return tuple(chambers)


def label_name(value: int, names: dict[int, str]) -> str:
    """Return the name of a label value, or "label N"."""
    return names.get(value, f"label {value}")


def _phases(labels: VolumeSeries) -> range:
    return range(len(labels.timing))


def _surface(labels: VolumeSeries, phase: int, value: int) -> Mesh:
    try:
        return surface_of_mask(labels.values[phase] == value, labels.grid)
    except InvalidInputError as error:
        raise InvalidInputError(f"in phase {phase}, {error}") from error
