"""Shared by the command tests: the synthetic intervention on disk, written once."""

from pathlib import Path

import pytest

from dvf_ig.core import Scenario
from dvf_ig.io import write_scenario


@pytest.fixture(scope="session")
def written(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario's folder, for tests that only read it."""
    folder = tmp_path_factory.mktemp("written") / "scenario"
    write_scenario(scenario, folder)
    return folder
