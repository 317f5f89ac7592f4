"""Fixture options: the same names in every command and in YAML, the defaults that help shows, retiming."""

import inspect
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from click import Command
from typer.testing import CliRunner

from dvf_ig.cli.fixture_options import LAW_NAMES, chosen_fixtures, chosen_retiming
from dvf_ig.cli.main import app
from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import Confinement, FixtureOptions, FixtureSet, Gaussian
from dvf_ig.intake.fixtures import LAWS
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
            if key in ("law", "name", "model"):
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
    assert chosen_retiming("uniform", None) == "uniform"
    assert chosen_retiming(None, "uniform") == "uniform"
    with pytest.raises(typer.BadParameter, match="leave out --retiming"):
        chosen_retiming("uniform", "uniform")


@pytest.mark.parametrize(
    ("options", "fixtures", "mode"),
    [
        ((), FixtureSet(), "two-segment"),
        (
            ("--law", "guidance", "--delta", "4", "--m", "2", "--retiming", "uniform"),
            FixtureSet((FixtureOptions(Gaussian(4.0, 2.0)),)),
            "uniform",
        ),
        (
            ("--inside", "--gamma", "2", "--depth-mm", "1", "--cap-n", "0.4", "--blend", "distance"),
            FixtureSet((FixtureOptions(Confinement(2.0, 0.4, 1.0), "distance"),)),
            "two-segment",
        ),
        (("--fixtures", "FILE"), FixtureSet((FixtureOptions(Gaussian(), name="guide"),), 0.5), "uniform"),
    ],
)
def test_a_replay_is_given_what_the_user_asked_for(
    options: tuple[str, ...], fixtures: FixtureSet, mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "fixtures.yaml"
    text = "{cap_n: 0.5, retiming: uniform, fixtures: [{law: guidance, name: guide}]}"
    file.write_text(text, encoding="utf-8")
    given: dict[str, object] = {}

    recorded = SimpleNamespace(preop=SimpleNamespace(patient_id=""))
    files = SimpleNamespace(fixtures=None, retiming=None, model=None, record=None, scenario=recorded)

    def asked(scenario: object, **arguments: object) -> None:
        given.update(arguments)
        raise InvalidInputError("asked")

    monkeypatch.setattr("dvf_ig.cli.replay.read_agreeing", lambda *_: (files, ()))
    monkeypatch.setattr("dvf_ig.cli.replay.patient_model", lambda *_: (None, ""))
    monkeypatch.setattr("dvf_ig.replay.run_replay", asked)
    words = [str(file) if word == "FILE" else word for word in options]
    done = CliRunner().invoke(app, ["replay", str(tmp_path), "-o", str(tmp_path / "run"), *words])
    assert "error: asked" in done.stderr
    assert given["fixtures"] == fixtures
    assert given["retiming"] == mode


@pytest.mark.parametrize(
    "options", [("--fixtures", "no.yaml", "--law", "guidance"), ("--law", "sigmoid"), ("--retiming", "cubic")]
)
def test_bad_fixture_options_end_a_replay_with_2(options: tuple[str, ...], tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["replay", str(tmp_path), "-o", str(tmp_path / "run"), *options])
    assert done.exit_code == 2
    assert not (tmp_path / "run").exists()
