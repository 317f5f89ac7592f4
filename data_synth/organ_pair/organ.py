"""Input of the ultrasound simulation: labels, their acoustics, and the position of the probe."""

from dataclasses import dataclass

from dvf_ig.core import AnyArray, FloatArray, Grid, read_only_arrays


@dataclass(frozen=True, slots=True)
class Acoustics:
    """Acoustics of tissues, one number a label.

    Attributes:
        echo_db: typical scattered level. Every pair varies them, and shows only a share of the differences.
        impedance: typical impedance, MRayl; also varied.
        loss_db_per_mm: one-way loss.
    """

    echo_db: tuple[float, ...]
    impedance: tuple[float, ...]
    loss_db_per_mm: tuple[float, ...]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class OrganLabels:
    """Labels around the insonified part of an organ.

    Attributes:
        grid: frame "moving".
        labels: (nx, ny, nz) uint8, tissue numbers.
        acoustics: acoustics of the tissues.
        entry_mm: (3,) point at which the probe touches the organ; inward: (3,) unit direction of its view.
        across: (3,) unit, along the probe's array; None for any direction.
    """

    grid: Grid
    labels: AnyArray
    acoustics: Acoustics
    entry_mm: FloatArray
    inward: FloatArray
    across: FloatArray | None = None
