"""A recorded intervention pushed through a session from raw streams to force, scored where truth exists."""

from .engine import Replay as Replay
from .engine import run_replay as run_replay
from .events import events_of as events_of
from .registration import register_scenario as register_scenario
from .result.result import evidence_of as evidence_of
from .result.result import result_of as result_of
from .result.result import schema as schema
from .result.result import validate as validate
from .table import table as table
