"""Points about the beating ball."""

import numpy as np
import pytest
from toy_ball import CENTERS


@pytest.fixture(scope="session")
def shell_points() -> np.ndarray:
    """(300, 3) points within some 6 mm of the ball's surface in every phase."""
    rng = np.random.default_rng(11)
    direction = rng.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * rng.uniform(9, 20, size=(300, 1)) + CENTERS.mean(axis=0)
