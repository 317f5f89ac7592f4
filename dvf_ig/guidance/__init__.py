"""From a registered, phased tool to a force: laws, blending, evaluation."""

from .blend import Blend as Blend
from .blend import blend_distances as blend_distances
from .blend import blend_forces as blend_forces
from .blend import static_force as static_force
from .device import DeviceLimits as DeviceLimits
from .evaluator import Evaluator as Evaluator
from .evaluator import ForceSamples as ForceSamples
from .laws import Gaussian as Gaussian
from .laws import Law as Law
from .laws import Sigmoid as Sigmoid
from .pose_and_phase import BoundTick as BoundTick
from .pose_and_phase import PoseAndPhase as PoseAndPhase
from .status import Status as Status
