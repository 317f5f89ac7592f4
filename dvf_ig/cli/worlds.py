"""Names of the synthetic worlds, and of the image quality of their hearts, as options take them."""

from enum import StrEnum


class World(StrEnum):
    """Which synthetic world; the second shares no table with the first and serves to report alone."""

    first = "first"
    second = "second"


class ImageQuality(StrEnum):
    """Presets of a scenario by the quality of its ultrasound images."""

    calm = "calm"
    poor_image = "poor-image"
