"""A recorded intervention, replayed from raw streams to force in time order, scored where truth exists."""

from .beat_evaluation import BeatEvaluation as BeatEvaluation
from .engine import Replay as Replay
from .engine import register_scenario as register_scenario
from .engine import run_replay as run_replay
from .pose_history import Attempt as Attempt
from .pose_history import PoseHistory as PoseHistory
from .result import evidence_of as evidence_of
from .result import result_of as result_of
from .result import schema as schema
from .result import validate as validate
from .table import table as table
