"""Seed points from which a segmentation grows."""

from dataclasses import dataclass

from .errors import InvalidInputError
from .frames import require_same_frame
from .points import Points


@dataclass(frozen=True, slots=True, eq=False)
class Seeds:
    """Seed points set by the user in the image.

    Attributes:
        heart: in the muscle.
        background: outside the heart; together they should surround it.
        cavity: in the blood inside the heart; may be empty where blood looks like muscle.
    """

    heart: Points
    background: Points
    cavity: Points

    def __post_init__(self) -> None:
        for name, points in (("heart", self.heart), ("background", self.background)):
            if len(points) == 0:
                raise InvalidInputError(f"no seed is named {name}; set at least one point of that name")
        require_same_frame(self.heart.frame, self.background.frame, "background seeds")
        require_same_frame(self.heart.frame, self.cavity.frame, "cavity seeds")
