"""One table of keys: the schema has no others, and the guide and `config init` show them all."""

from pathlib import Path

import pytest
import typer
from pydantic import BaseModel

from dvf_ig.cli.main import app
from dvf_ig.intake.parts import PARTS
from dvf_ig.intake.schema import KEYS, SessionConfig, key_table

GUIDE = Path(__file__).resolve().parents[2] / "dvf_ig/docs/guide/own-recordings.md"


def leaves(section: type[BaseModel], within: str = "") -> list[str]:
    """Keys of a section by their dotted names; what `KEYS` describes as a whole is not taken apart."""
    names = []
    for name, field in section.model_fields.items():
        options = getattr(field.annotation, "__args__", (field.annotation,))
        inner = next((one for one in options if isinstance(one, type) and issubclass(one, BaseModel)), None)
        if inner is None or f"{within}{name}" in KEYS:
            names.append(f"{within}{name}")
        else:
            names += leaves(inner, f"{within}{name}.")
    return names


def test_the_table_has_every_key_in_the_order_of_the_schema() -> None:
    assert [name for name in leaves(SessionConfig) if name != "schema_"] == list(KEYS)


def test_the_guide_shows_the_table() -> None:
    assert key_table() in GUIDE.read_text(encoding="utf-8")


def test_config_init_has_an_option_for_every_key_that_says_so() -> None:
    init = typer.main.get_command(app).commands["config"].commands["init"]  # type: ignore[attr-defined]
    there = {name for param in init.params for name in param.opts}
    assert there == {"-o", "--out", "--json"} | {name for key in KEYS.values() for name in key.options}


@pytest.mark.parametrize("part", PARTS, ids=[part.key for part in PARTS])
def test_a_part_has_keys_and_says_how_to_come_by_it(part: object) -> None:
    key, missing = str(getattr(part, "key")), str(getattr(part, "missing"))  # noqa: B009
    assert any(name == key or name.startswith(f"{key}.") for name in KEYS)
    if getattr(part, "needed_for") is not None:  # noqa: B009
        assert missing.startswith(("a registration needs ", "a force needs "))
