"""What `dvf-ig register` can be given, and which options go with each."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import typer


class Kind(StrEnum):
    """What the ultrasound comes from; each value is the option, or argument, that says so."""

    scenario = "SCENARIO"
    config = "--config"
    recordings = "--us"
    volumes = "--us-volume"
    pair = "--fixed and --moving"


HEART = {"--model", "--mr", "--labels", "--organ", "--cavity", "--patient"}
START = {"--start", "--start-landmarks", "--touched"}
CALIBRATION = {"--probe", "--lag-s", "--latency", "--fan", "--probe-name", "--reference-name"}
OPTIONS: dict[Kind, set[str]] = {
    Kind.scenario: {"--model", "--start"},
    Kind.config: set(),
    Kind.recordings: HEART | START | CALIBRATION | {"--ecg", "--rate", "--ecg-start"},
    Kind.volumes: HEART | {"--ecg", "--rate", "--start", "--start-landmarks"},
    Kind.pair: {"--start", "--mask"},
}


def kind_of(given: Mapping[Kind, Any], options: Mapping[str, Any]) -> Kind:
    """What was given, with no option that does not go with it.

    Args:
        given: value of what says each kind; None where it was not given.
        options: value of every other option; None where it was not given.
    Raises:
        typer.BadParameter: nothing, or several, or an option of another kind.
    """
    kinds = [kind for kind, value in given.items() if value is not None]
    if len(kinds) != 1:
        every = ", ".join(Kind)
        got = f" (got {', '.join(kinds)})" if kinds else ""
        raise typer.BadParameter(f"what is to be registered? give one of {every}{got}")
    kind = kinds[0]
    for option, value in options.items():
        if value is not None and option not in OPTIONS[kind]:
            fits = ", ".join(other for other, fit in OPTIONS.items() if option in fit)
            raise typer.BadParameter(f"{option} does not go with {kind}; it goes with {fits}")
    return kind
