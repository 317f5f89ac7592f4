"""The synthetic world with its truth."""

from .faults import describe_faults as describe_faults
from .presets import MOTIONS as MOTIONS
from .presets import PRESETS as PRESETS
from .presets import Motion as Motion
from .presets import Preset as Preset
from .presets import ScenarioSpec as ScenarioSpec
from .presets import preset_name as preset_name
from .probe_path import ReplayedPath as ReplayedPath
from .probe_path import replayed_path as replayed_path
from .scenario import phantom_scenario as phantom_scenario
from .scenario import surface_scenario as surface_scenario
