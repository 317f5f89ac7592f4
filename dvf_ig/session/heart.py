"""What the pre-operative data give: the fixture model and the channels that ultrasound is compared with."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import (
    DvfModel,
    FloatArray,
    Grid,
    InvalidInputError,
    Preop,
    VolumeSeries,
    read_only_arrays,
)
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.preop import close_surface, model_from_preop, rasterise
from dvf_ig.registration import (
    BLOOD,
    WALL,
    BoundaryTarget,
    ModelChannels,
    channels_from_labels,
    channels_from_mr,
    normalised_grey,
    root_amplitude,
    target_from_labels,
)

COARSE_PITCH_MM = 3.0
FINE_PITCH_MM = 2.0
MR_SMOOTHING_MM = 2.5
"""On tuning seeds 101–104 TRE and force error are 1.29 mm and 0.077 N with 2.0; 1.15 and 0.079 with 2.5;
1.09 and 0.092 with 3.0."""
LABEL_VOXEL_MM = 2.0
LABEL_SMOOTHING_MM = 1.5
LABEL_MARGIN_MM = 20.0

MR_BOUNDARY_SHARE = 0.35
LABEL_BOUNDARY_SHARE = 0.8
"""How far a registration goes from LC2's pose to that of the boundary. Real surfaces, tuning seeds 101 and
102, windows of 8 to 30 s: boundary 1.4 to 2.1 mm off (3.7 once), LC2 on label maps 1.7 to 3.7 mm."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Heart:
    """The fixture model, and what ultrasound is registered to.

    Attributes:
        model: signed distance per phase.
        coarse, fine: channels at the two pitches of registration.
        center_mm: (3,) centre of the heart box.
        surface: the boundary of blood and wall, which ultrasound shows; None without a cavity.
        boundary_share: how far a registration goes from LC2's pose (0) to that of the boundary (1).
        beats_update_pose: whether LC2 on these channels is good enough for a single beat to move the pose.
        brightness: of ultrasound that is compared with these channels.
    """

    model: DvfModel
    coarse: ModelChannels
    fine: ModelChannels
    center_mm: FloatArray
    surface: BoundaryTarget | None
    boundary_share: float
    beats_update_pose: bool = True
    brightness: Callable[[NDArray[np.uint8]], NDArray[np.float32]] = root_amplitude


def build_heart(
    preop: Preop, model: DvfModel | None = None, progress: Callable[[float], None] | None = None
) -> Heart:
    """Build model and channels from a 4-D image with labels, or from a surface-only data set.

    Args:
        model: a model of this patient that was built before; saves building it.
    Raises:
        InvalidInputError: neither labels nor surfaces, no such surface, or another patient's model.
    """
    if model is None:
        model = model_from_preop(preop, progress=progress)
    elif model.patient_id != preop.patient_id:
        raise InvalidInputError(
            f"the model is of patient '{model.patient_id}', the scenario of '{preop.patient_id}'; "
            "build a model from this patient's images"
        )
    vertices = model.reference[model.ed_phase].vertices_mm
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    labels = label_map(preop)
    seen = bool((labels.values == BLOOD).any())
    with ThreadPoolExecutor(thread_count()) as pool:
        target = pool.submit(target_from_labels, labels, labels.timing.fractions) if seen else None
        if preop.mr is not None:
            channels = channels_from_mr(preop.mr, smoothing_mm=MR_SMOOTHING_MM)
        else:
            channels = channels_from_labels(labels, smoothing_mm=LABEL_SMOOTHING_MM)
        surface = target.result() if target is not None else None
    if preop.mr is not None:
        return Heart(model, channels, channels, center, surface, MR_BOUNDARY_SHARE)
    return Heart(model, channels, channels, center, surface, LABEL_BOUNDARY_SHARE, False, normalised_grey)


def label_map(preop: Preop) -> VolumeSeries:
    """Wall and blood (1, 2) of the heart, from its label image or by rasterising its surfaces."""
    if preop.labels is not None:
        names = dict(preop.label_names)
        table = np.zeros(256, dtype=np.uint8)
        for value in preop.organ_labels:
            table[value] = BLOOD if "blood" in names.get(value, "") else WALL
        return VolumeSeries(preop.labels.grid, table[preop.labels.values], preop.labels.timing)
    closed = {s.name: close_surface(s) for s in preop.surfaces}
    vertices = closed[preop.surface].vertices_mm.reshape(-1, 3)
    low, high = vertices.min(axis=0) - LABEL_MARGIN_MM, vertices.max(axis=0) + LABEL_MARGIN_MM
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / LABEL_VOXEL_MM) + 1)
    grid = Grid.axis_aligned(closed[preop.surface].frame, (nx, ny, nz), low, LABEL_VOXEL_MM)
    return rasterise(closed, grid)
