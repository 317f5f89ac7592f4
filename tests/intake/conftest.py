"""Fixtures of readers and of a lab's folder, for what is made of files."""

from tests.cli.config.conftest import files as files
from tests.cli.config.conftest import lab as lab
from tests.io.conftest import assert_same as assert_same
from tests.io.conftest import in_a_command as in_a_command
from tests.io.conftest import make_scenario as make_scenario
