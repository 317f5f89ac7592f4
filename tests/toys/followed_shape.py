"""A change of shape that is followed, of which a warp and its walls alone are known."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dvf_ig.core import Rigid, Warp
from dvf_ig.registration.shape.estimate import AS_IN_MODEL, Contraction, GuardedWalls

SURE_WALLS = GuardedWalls(np.eye(6), 0.1, 0.01)


@dataclass(frozen=True, eq=False)
class FollowedShape:
    """Stands for a `ShapeEstimate` that no beat corrects."""

    warp: Warp
    walls: GuardedWalls = SURE_WALLS
    contraction: Contraction = AS_IN_MODEL

    def predicted(self, beats: float) -> "FollowedShape":
        return self

    def at_pose(self, registered: Rigid, pose: Rigid) -> "FollowedShape":
        return replace(self, warp=self.warp.at_pose(registered, pose))

    def intersected_with(self, registered: Any) -> Any:
        return registered


def followed_shape(warp: Warp, walls: GuardedWalls = SURE_WALLS) -> Any:
    return FollowedShape(warp, walls)
