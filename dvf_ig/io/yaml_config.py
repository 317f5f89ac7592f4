"""Read YAML configurations: sections with known keys, and errors that state the file and the key."""

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from dvf_ig.core.errors import UnreadableFileError

from .limits import SETTINGS_BYTES
from .reading import read_text
from .yaml_text import parse_yaml

KIND = "~"
"""First character of the tag of a value that may be of several kinds; not a key of the document."""
MOST_PROBLEMS = 5
"""Most problems reported at once."""


class Section(BaseModel):
    """Section of a configuration: an unknown key is an error that lists the known ones."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, values: Any) -> Any:
        if isinstance(values, dict):
            keys = [field.alias or name for name, field in cls.model_fields.items()]
            unknown = [str(key) for key in values if key not in keys and key not in cls.model_fields]
            if unknown:
                raise ValueError(f"unknown key {', '.join(unknown)}; needed some of {', '.join(keys)}")
        return values


S = TypeVar("S", bound=BaseModel)


def read_yaml(path: Path, what: str) -> Any:
    """Read the document in a YAML file.

    Args:
        path: the file.
        what: the expected content with its article, for example "a scenario description".
    Raises:
        UnreadableFileError: absent, not YAML, or ambiguous YAML (`parse_yaml`).
    """
    return parse_yaml(read_text(path, what, SETTINGS_BYTES), path, what)


def validated(section: type[S], document: Any, path: Path) -> S:
    """Validate the document as a section.

    Raises:
        UnreadableFileError: unknown keys, or missing or wrong values; names the file and each key.
    """
    try:
        return section.model_validate(document)
    except ValidationError as exc:
        problems = "; ".join(_sentence(error, document) for error in exc.errors()[:MOST_PROBLEMS])
        raise UnreadableFileError(f"{path}: {problems}") from exc


_MESSAGES = {
    "missing": "it is missing",
    "model_type": "needed keys with their values",
    "model_attributes_type": "needed keys with their values",
    "string_type": "needed a text",
    "string_too_short": "it is empty",
    "float_type": "needed a number",
    "int_type": "needed a whole number",
    "tuple_type": "needed a list, such as [1, 2]",
}
"""Messages that replace pydantic's own, which mention Python types."""


def _sentence(error: Any, document: Any) -> str:
    key = _key(error["loc"], document)
    context = error.get("ctx", {})
    if error["type"] == "union_tag_not_found":
        return f"{key}: its {context['discriminator']} is missing"
    if error["type"] == "union_tag_invalid":
        name = context["discriminator"].strip("'")
        return f"{key}.{name} is '{context['tag']}'; needed {context['expected_tags']}"
    message = _MESSAGES.get(error["type"]) or error["msg"].removeprefix("Value error, ")
    return f"{key}: {message}" if key else message


def _key(location: tuple[int | str, ...], document: Any) -> str:
    """Join the keys and indices of the document that lead to a problem.

    If the items of a list may be of several kinds, pydantic adds the kind of the item after its index.
    """
    words: list[str] = []
    here = document
    for previous, part in zip((None, *location), location, strict=False):
        if isinstance(part, str) and part.startswith(KIND):
            continue
        if isinstance(previous, int) and isinstance(here, dict) and part in here.values():
            continue
        words.append(str(part))
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            here = None
    return ".".join(words)
