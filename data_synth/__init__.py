"""Synthetic world with its truth.

Whole interventions (`phantom_scenario`, `surface_scenario`) and image pairs (`image_pair`), and their parts,
each usable alone: a beating heart, its MR and ultrasound, signals, calibration phantoms, an operator's hands.
"""

from data_synth.scenario.presets import describe_faults as describe_faults

from .cine_heart.anatomy import LV_LABEL as LV_LABEL
from .cine_heart.anatomy import RV_LABEL as RV_LABEL
from .cine_heart.anatomy import CineHeart as CineHeart
from .cine_heart.anatomy import require_heart_size as require_heart_size
from .heart.anatomy import PhantomAnatomy as PhantomAnatomy
from .heart.anatomy import phantom_anatomy as phantom_anatomy
from .heart.clock import two_segment_phase as two_segment_phase
from .heart.heart_spec import HEART_KINDS as HEART_KINDS
from .heart.heart_spec import HeartSpec as HeartSpec
from .heart.motion import MotionPreset as MotionPreset
from .heart.tissue import Tissue as Tissue
from .mr.cine import cine_preop as cine_preop
from .mr.examination import Examination as Examination
from .mr.examination import examination as examination
from .operator.contact import MovingSurface as MovingSurface
from .operator.probe_path import ReplayedPath as ReplayedPath
from .operator.probe_path import replayed_path as replayed_path
from .phantoms.crosswire import CrossWireSpec as CrossWireSpec
from .phantoms.crosswire import crosswire_recording as crosswire_recording
from .phantoms.nwire import NWireSpec as NWireSpec
from .phantoms.nwire import nwire_images as nwire_images
from .phantoms.nwire import nwire_recording as nwire_recording
from .phantoms.pivot import pivot_recording as pivot_recording
from .phantoms.wall import WallSpec as WallSpec
from .phantoms.wall import wall_recording as wall_recording
from .phantoms.watertank import watertank_images as watertank_images
from .scenario.ground_truth import draw_ground_truth as draw_ground_truth
from .scenario.presets import MOTIONS as MOTIONS
from .scenario.presets import PRESETS as PRESETS
from .scenario.presets import Preset as Preset
from .scenario.presets import ScenarioSpec as ScenarioSpec
from .scenario.presets import preset_name as preset_name
from .scenario.recording import cine_scenario as cine_scenario
from .scenario.recording import phantom_scenario as phantom_scenario
from .scenario.recording import preoperative_surface as preoperative_surface
from .scenario.recording import scenario_examination as scenario_examination
from .scenario.recording import surface_scenario as surface_scenario
from .second_world.gated_volumes import second_world_pair as second_world_pair
from .second_world.recording import SecondWorldRecording as SecondWorldRecording
from .second_world.recording import SecondWorldSpec as SecondWorldSpec
from .second_world.recording import second_world_recording as second_world_recording
from .seeds import child_rng as child_rng
from .signals.ecg import EcgSpec as EcgSpec
from .signals.ecg import synthetic_ecg as synthetic_ecg
from .signals.rhythm import RhythmSpec as RhythmSpec
from .signals.rhythm import beat_series as beat_series
from .signals.tracker import TrackerSpec as TrackerSpec
from .ultrasound.image_probe import CalibratedImage as CalibratedImage
from .ultrasound.label_anatomy import LabelAnatomy as LabelAnatomy
from .ultrasound.label_anatomy import label_anatomy as label_anatomy
from .ultrasound.presets import probe_named as probe_named
from .ultrasound.probe import SectorProbe as SectorProbe
from .ultrasound.sequence import simulate_frame as simulate_frame
from .ultrasound.views import VIEW_PROBE as VIEW_PROBE
from .ultrasound.volume import MatrixProbe as MatrixProbe
from .ultrasound.volume import simulate_volume as simulate_volume
