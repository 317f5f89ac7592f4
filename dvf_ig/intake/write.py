"""A session.yaml as text: as `config init` begins it, with comments; complete, as `config dump` shows it."""

from collections.abc import Mapping
from typing import Any

from dvf_ig.io.yaml_text import yaml_text

from .parts import PARTS
from .schema import KEYS, SCHEMA, Key, SessionConfig

SCHEMA_FILE = "session.schema.json"
HEAD = (
    f"# yaml-language-server: $schema={SCHEMA_FILE}",
    "# The files of one intervention; names are relative to the folder of this file.",
    "#   dvf-ig config validate session.yaml    opens them all and says what does not fit",
    f"#   dvf-ig config schema -o {SCHEMA_FILE}    lets an editor complete and check this file",
    "#   dvf-ig register session.yaml -o OUT    where the patient is",
    "#   dvf-ig replay session.yaml -o RUN      from raw streams to force",
    f"schema: {SCHEMA}",
)


def session_text(config: SessionConfig, described: Mapping[str, str | None]) -> str:
    """YAML with a comment for everything that it says or could say.

    Args:
        described: what the files of each part hold, by its key.
    """
    stated = config.model_dump(exclude_defaults=True)
    blocks = ["\n".join(HEAD)]
    sections: dict[str, list[str]] = {}
    for name, key in KEYS.items():
        section, _, entry = name.rpartition(".")
        value = stated.get(section, {}).get(entry) if section else stated.get(entry)
        if key.example or value is not None:
            sections.setdefault(section or entry, []).append(_line(entry, value, key))
    for name, lines in sections.items():
        blocks.append("\n".join(_block(name, lines, stated, described)))
    return "\n\n".join(blocks) + "\n"


def session_schema() -> dict[str, Any]:
    """JSON schema of a session.yaml, for editors; each key's description is that of its comment."""
    schema: dict[str, Any] = SessionConfig.model_json_schema(by_alias=True)
    for name, key in KEYS.items():
        section, _, entry = name.rpartition(".")
        described = schema["properties"].get(section, {})
        kinds = [
            kind["$ref"].rpartition("/")[2]
            for kind in (described, *described.get("anyOf", ()))
            if "$ref" in kind
        ]
        for place in [schema["$defs"][kind] for kind in kinds] if section else [schema]:
            if entry in place["properties"]:
                place["properties"][entry]["description"] = key.note
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA, **schema}


def dump_text(config: SessionConfig) -> str:
    """YAML of the complete configuration, every default written out; it reads back to the same."""
    head = (
        "# Every key of a session's configuration; null: not given. Without fixtures one forbidden region\n"
        "# acts (its numbers: dvf-ig replay --help); without retiming the law is two-segment.\n"
    )
    return head + yaml_text(config.model_dump(by_alias=True), flow=None)


def _line(entry: str, value: Any, key: Key) -> str:
    """A key with its value, or with an example that is commented out, and what it is."""
    if value is None:
        return f"# {entry}: {key.example}  # {key.note}"
    shown = yaml_text([value], flow=True, width=10_000).strip().removeprefix("[").removesuffix("]")
    return f"{entry}: {shown}  # {key.holds}"


def _block(
    name: str, lines: list[str], stated: Mapping[str, Any], described: Mapping[str, str | None]
) -> list[str]:
    """A section with its comments; its own line is commented out if nothing in it is given."""
    if name in KEYS:
        return lines
    annotation = SessionConfig.model_fields[name].annotation
    kind = next(iter(one for one in getattr(annotation, "__args__", (annotation,)) if one is not type(None)))
    comments = [f"# {(kind.__doc__ or '').splitlines()[0]}"]
    for part in PARTS:
        contents = described.get(part.key)
        if part.key.partition(".")[0] == name and contents is not None:
            inside = "in the ultrasound's file: " if name in ("ecg", "tool") and name not in stated else ""
            label = "" if part.key == name else f"{part.label}, "
            comments.append(f"# Found: {label}{inside}{contents}.")
    if name in stated:
        return [*comments, f"{name}:", *(f"  {line}" for line in lines)]
    return [*comments, f"# {name}:", *(f"#   {line.removeprefix('# ')}" for line in lines)]
