"""The JSON schema of `result.json`."""

import json
from importlib import resources
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from dvf_ig.core import InvalidInputError

SCHEMA = "dvf_ig.replay/1"


def schema() -> dict[str, Any]:
    """Load the JSON schema of result.json."""
    text = resources.files(__package__).joinpath("result.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def validate(result: dict[str, Any]) -> None:
    """Raise InvalidInputError unless `result` fits the schema."""
    error = best_match(Draft202012Validator(schema()).iter_errors(result))
    if error is not None:
        raise InvalidInputError(f"result.json does not fit {SCHEMA}: {error.message}") from error
