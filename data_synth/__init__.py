"""The synthetic world with its truth."""

from .heart.motion import MotionPreset as MotionPreset
from .operator.probe_path import ReplayedPath as ReplayedPath
from .operator.probe_path import replayed_path as replayed_path
from .scenario.faults import describe_faults as describe_faults
from .scenario.presets import MOTIONS as MOTIONS
from .scenario.presets import PRESETS as PRESETS
from .scenario.presets import Preset as Preset
from .scenario.presets import ScenarioSpec as ScenarioSpec
from .scenario.presets import preset_name as preset_name
from .scenario.recording import phantom_scenario as phantom_scenario
from .scenario.recording import surface_scenario as surface_scenario
