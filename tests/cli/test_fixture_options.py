"""Fixture options: the same names in every command and in YAML, the defaults that help shows, retiming."""

import inspect

import pytest
import typer
from click import Command

from dvf_ig.cli.fixture_options import LAW_NAMES, RetimingName, chosen_fixtures, chosen_retiming
from dvf_ig.cli.main import app
from dvf_ig.guidance import Confinement, FixtureOptions, FixtureSet, Gaussian
from dvf_ig.io.fixtures import LAWS
from dvf_ig.replay import run_replay

FIXTURE_COMMANDS = ("force", "replay")


def options_of(name: str) -> dict[str, typer.core.TyperOption]:
    command: Command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    return {option.opts[0]: option for option in command.params}  # type: ignore[misc]


@pytest.mark.parametrize("name", FIXTURE_COMMANDS)
def test_options_are_the_keys_of_yaml_with_their_defaults(name: str) -> None:
    options = options_of(name)
    assert "--fixtures" in options
    for law in LAW_NAMES:
        for key, field in LAWS[law].model_fields.items():
            if key in ("law", "name"):
                continue
            shown = options[f"--{key.replace('_', '-')}"].show_default
            assert key == "inside" or shown == str(field.default), key
    assert options["--law"].show_default == "forbidden"


def test_only_a_replay_retimes() -> None:
    default = inspect.signature(run_replay).parameters["retiming"].default
    assert options_of("replay")["--retiming"].show_default == default
    assert "--retiming" not in options_of("force")


def test_what_is_given_reaches_the_fixture() -> None:
    nothing = dict.fromkeys(("law", "gamma", "delta", "m", "cap_n", "depth_mm", "inside", "blend"))
    assert chosen_fixtures(nothing, None) == (FixtureSet(), None)
    inside, _ = chosen_fixtures({**nothing, "inside": True, "depth_mm": 2.0}, None)
    assert inside.fixtures == (FixtureOptions(Confinement(depth_mm=2.0)),)
    guide, _ = chosen_fixtures({**nothing, "law": "guidance", "m": 2.0, "blend": "periodic"}, None)
    assert guide.fixtures == (FixtureOptions(Gaussian(m=2.0), "periodic"),)


def test_retiming_is_given_once() -> None:
    assert chosen_retiming(None, None) == "two-segment"
    assert chosen_retiming(RetimingName.uniform, None) == "uniform"
    assert chosen_retiming(None, "uniform") == "uniform"
    with pytest.raises(typer.BadParameter, match="leave out --retiming"):
        chosen_retiming(RetimingName.uniform, "uniform")
