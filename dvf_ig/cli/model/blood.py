"""Which labels are blood: what a user is told where nothing says so."""

import numpy as np

from dvf_ig.cli.shell import warn
from dvf_ig.core import Volume, VolumeSeries


def warn_of_no_blood(what_to_do: str) -> None:
    """Tell that a model has no chambers of blood, and what to do."""
    warn(
        "nothing says where the blood is, so the model holds no boundary of it, which registration to "
        f"ultrasound goes by, and end-systole is where the whole surface encloses least: {what_to_do}"
    )


def labels_told(image: VolumeSeries, labels: Volume, ed_phase: int) -> str:
    """Volume and mean grey level of each label at end-diastole: blood is bright in most cines."""
    voxel_ml = float(np.prod(labels.grid.spacing_mm)) / 1000.0
    grey = image.values[ed_phase]
    told = []
    for value in np.unique(labels.values[labels.values != 0]).tolist():
        inside = labels.values == value
        told.append(f"{value}: {inside.sum() * voxel_ml:.0f} ml of mean grey level {grey[inside].mean():.0f}")
    return "; ".join(told)
