"""One gated 3-D ultrasound image with the pose at which it was taken."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.space.volume import Volume


@dataclass(frozen=True, slots=True, eq=False)
class TrackedVolume:
    """Gated 3-D ultrasound image, with its pose and its phase of the model.

    Attributes:
        image: uint8 log-compressed grey levels, in the frame of the transducer.
        mask: non-zero if a voxel was insonified, on the same grid.
        tracker_from_image: pose of the image's frame.
        model_phase: position in the model's cycle at which it was taken, [0, 1).
        t_s: event time.
    """

    image: Volume
    mask: Volume
    tracker_from_image: Rigid
    model_phase: float
    t_s: float = 0.0

    def __post_init__(self) -> None:
        if self.image.values.dtype != np.uint8:
            raise InvalidInputError(
                f"a tracked ultrasound volume holds {self.image.values.dtype}; needed uint8 grey levels"
            )
        if self.mask.values.shape != self.image.values.shape:
            raise InvalidInputError(
                f"the mask has shape {self.mask.values.shape}, the volume {self.image.values.shape}; "
                "needed the same grid"
            )
        if not 0.0 <= self.model_phase < 1.0:
            raise InvalidInputError(f"the model phase is {self.model_phase:g}; needed 0 to below 1")
        require_same_frame(self.image.grid.frame, self.tracker_from_image.source, "tracked volume")
