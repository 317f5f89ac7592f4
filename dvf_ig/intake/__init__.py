"""From a lab's files to a session: its parts, their agreement, scenario folders, cached models, its log."""

from .describe.file import describe as describe
from .fixtures import read_fixtures as read_fixtures
from .model_cache import cached_model as cached_model
from .scenario_write import ScenarioNotes as ScenarioNotes
from .scenario_write import write_scenario as write_scenario
from .session import read_scenario as read_scenario
from .session import read_session as read_session
