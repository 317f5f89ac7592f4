"""Rulers and clocks: tool tip, image calibration, video lag, landmark registration."""

from .landmarks import DwellOptions as DwellOptions
from .landmarks import Dwells as Dwells
from .landmarks import LandmarkResult as LandmarkResult
from .landmarks import find_dwells as find_dwells
from .landmarks import register_landmarks as register_landmarks
from .landmarks import tip_positions as tip_positions
from .latency import LatencyOptions as LatencyOptions
from .latency import LatencyResult as LatencyResult
from .latency import estimate_latency as estimate_latency
from .latency import principal_motion_mm as principal_motion_mm
from .nwire import WireErrors as WireErrors
from .nwire import diagonal_crossings as diagonal_crossings
from .pivot import PivotOptions as PivotOptions
from .pivot import PivotResult as PivotResult
from .pivot import calibrate_pivot as calibrate_pivot
from .pivot import rotation_span_deg as rotation_span_deg
from .probe import PROBE_METHODS as PROBE_METHODS
from .probe import ProbeMethod as ProbeMethod
from .probe import ProbeOptions as ProbeOptions
from .probe import ProbeResult as ProbeResult
from .probe import calibrate_probe as calibrate_probe
from .probe import validate_probe as validate_probe
