"""Registration of the toy heart, for tests that need any result."""

from functools import lru_cache
from time import perf_counter

import numpy as np
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.registration import (
    HeartChannels,
    Level,
    RegistrationOptions,
    RegistrationResult,
    UltrasoundImages,
    channels_from_mr,
    register,
)


@lru_cache(maxsize=1)
def any_result() -> RegistrationResult:
    """A registration of the toy heart: what the stub's results say besides their pose."""
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.1)
    level, channels = Level(slices, 3.0), channels_from_mr(toy_mr(), smoothing_mm=3.0)
    images = UltrasoundImages(level, level, options=RegistrationOptions(starts=1))
    heart = HeartChannels(channels, CENTER_MM)
    return register(images, heart, toy_pose(), rng=np.random.default_rng(0), clock=perf_counter)
