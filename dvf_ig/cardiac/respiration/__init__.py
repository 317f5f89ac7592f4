"""The clock of breathing: what follows the breath, its state, and its forecast; causal."""

from .beat_clock import BeatClock as BeatClock
from .beat_clock import breath_rates as breath_rates
from .beat_clock import breathing_in_beats as breathing_in_beats
from .breath_clock import PARTING as PARTING
from .breath_clock import Breath as Breath
from .breath_clock import BreathEvent as BreathEvent
from .breath_clock import BreathReading as BreathReading
from .breath_clock import BreathState as BreathState
from .qrs_gain import QrsGain as QrsGain
from .qrs_gain import beat_values as beat_values
from .surrogate import SurrogateScale as SurrogateScale
from .surrogate import learn_scale as learn_scale
from .tracking import RELEARN_BREATHS as RELEARN_BREATHS
from .tracking import BreathTrack as BreathTrack
from .tracking import RelearningClock as RelearningClock
from .tracking import track_breathing as track_breathing
