"""What ultrasound is simulated of: labels, how each sounds, and where the probe stands."""

from dataclasses import dataclass

from dvf_ig.core import AnyArray, FloatArray, Grid, read_only_arrays


@dataclass(frozen=True, slots=True)
class Acoustics:
    """How tissues sound, one number a label.

    Attributes:
        echo_db: typical scattered level. Every pair varies them, and shows only a share of the differences.
        impedance: typical, MRayl; varied too.
        loss_db_per_mm: one way.
    """

    echo_db: tuple[float, ...]
    impedance: tuple[float, ...]
    loss_db_per_mm: tuple[float, ...]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class OrganLabels:
    """Labels around what ultrasound sees.

    Attributes:
        grid: frame "moving".
        labels: (nx, ny, nz) uint8, tissue numbers.
        acoustics: of the tissues.
        entry_mm: (3,) where the probe touches the organ; inward: (3,) unit, where it looks.
        across: (3,) unit, along the probe's array; None where it may lie in any direction.
    """

    grid: Grid
    labels: AnyArray
    acoustics: Acoustics
    entry_mm: FloatArray
    inward: FloatArray
    across: FloatArray | None = None
