"""Cardiac phase: R peaks, phase estimation, heart-rate retiming of the pre-operative cycle (T_d).

All of it is causal except `beat_phase`, which needs the R peak after the time as well.
"""

from .lead_off import LeadChange as LeadChange
from .phase_clock import PhaseClock as PhaseClock
from .phase_tracking import PhaseTracking as PhaseTracking
from .phase_tracking import TriggerDetector as TriggerDetector
from .phase_tracking import beat_phase as beat_phase
from .phase_tracking import phase_from_peaks as phase_from_peaks
from .phase_tracking import stream_recording as stream_recording
from .phase_tracking import track_phase as track_phase
from .retime import RetimeMode as RetimeMode
from .retime import frame_period_s as frame_period_s
from .retime import retime as retime
from .retime import retiming_curve as retiming_curve
from .rpeak import RPeak as RPeak
from .rpeak import RPeakDetector as RPeakDetector
from .rpeak import detect_r_peaks as detect_r_peaks
from .rr_predictor import PREDICTORS as PREDICTORS
from .rr_predictor import PredictorName as PredictorName
from .rr_predictor import make_predictor as make_predictor
from .summary import MIN_BEATS as MIN_BEATS
from .summary import state_segments as state_segments
from .summary import summarise_gating as summarise_gating
