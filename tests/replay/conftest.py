"""One short synthetic intervention and its replay, shared by the replay tests."""

import pytest

from data_synth.presets import ScenarioSpec
from data_synth.scenario import phantom_scenario
from dvf_ig.core import Scenario
from dvf_ig.replay import Replay, run_replay

SECONDS = 17.0


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return phantom_scenario(ScenarioSpec(preset="calm", motion="paper5mm", seconds=SECONDS, seed=77))


@pytest.fixture(scope="session")
def replay(scenario: Scenario) -> Replay:
    return run_replay(scenario, seed=0)
