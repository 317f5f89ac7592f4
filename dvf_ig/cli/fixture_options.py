"""Options that describe virtual fixtures, shared by the commands that evaluate them."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Option

from .shell import set_options

if TYPE_CHECKING:
    from dvf_ig.cardiac import RetimeMode
    from dvf_ig.guidance import FixtureSet

LAW_NAMES = ("forbidden", "guidance")
SECTION = "Fixture"
"""Heading of these options under `--help`."""
FORMER_LAWS = {"sigmoid": "forbidden", "gaussian": "guidance"}


def _law(name: str) -> str:
    if name in FORMER_LAWS:
        raise typer.BadParameter(f"{name} is now called {FORMER_LAWS[name]}")
    if name == "path":
        raise typer.BadParameter("a path has points; describe it in a file and give that with --fixtures")
    if name not in LAW_NAMES:
        raise typer.BadParameter(f"'{name}' is not a law; needed {' or '.join(LAW_NAMES)}")
    return name


def _option(flag: str, kind: Any, help: str, **more: Any) -> Any:
    return Annotated[kind, Option(flag, rich_help_panel=SECTION, help=help, **more)]


FIXTURE: dict[str, Any] = {
    "law": _option(
        "--law",
        str | None,
        "forbidden: keep out of the organ. guidance: pull to its surface.",
        parser=_law,
        metavar="[forbidden|guidance]",
        show_default="forbidden",
    ),
    "gamma": _option(
        "--gamma", float | None, "Forbidden: steepness in 1/mm, 0.23 or more.", show_default="1.0"
    ),
    "delta": _option("--delta", float | None, "Guidance: width in mm.", show_default="3.0"),
    "m": _option("--m", float | None, "Guidance: exponent.", show_default="1.0"),
    "cap_n": _option(
        "--cap-n",
        float | None,
        "Largest force in N, up to 4; more in a file of --fixtures that names the device.",
        show_default="0.6",
    ),
    "depth_mm": _option(
        "--depth-mm", float | None, "Depth of the surface below the organ's, in mm.", show_default="0.0"
    ),
    "inside": _option("--inside", bool, "Forbidden: confine inside the surface instead of keeping out."),
    "blend": _option(
        "--blend",
        Literal["force", "distance", "periodic"] | None,
        "How phases are blended.",
        show_default="force",
    ),
}
"""Options of a single fixture by their keys in YAML; defaults shown are those of `dvf_ig.intake.fixtures`."""


def takes_fixture(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of FIXTURE in the place of its parameter `fixture`, a mapping of them.

    None or False: the option was not given.
    """

    @wraps(function)
    def run(**values: Any) -> None:
        function(fixture={key: values.pop(key) for key in FIXTURE}, **values)

    options: dict[str, tuple[Any, Any]] = {}
    for one in inspect.signature(function).parameters.values():
        if one.name == "fixture":
            options |= {key: (kind, False if key == "inside" else None) for key, kind in FIXTURE.items()}
        else:
            options[one.name] = (one.annotation, one.default)
    set_options(run, options)
    return run


FixturesFileOption = Annotated[
    Path | None,
    Option(
        "--fixtures",
        rich_help_panel=SECTION,
        help="YAML of one or several fixtures, on the heart and further structures, in place of the "
        "options of one.",
    ),
]
RetimingOption = Annotated[
    Literal["uniform", "two-segment"] | None,
    Option(
        "--retiming",
        rich_help_panel=SECTION,
        help="uniform: the cycle stretches as a whole. two-segment: systole shortens less than diastole.",
        show_default="two-segment",
    ),
]


def _margin(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


MarginOption = Annotated[
    # typer takes one type; the parser gives a name or a number
    str | None,
    Option(
        "--margin",
        rich_help_panel=SECTION,
        parser=_margin,
        metavar="[off|fixed|adaptive|MM]",
        help="Widen forbidden regions and soften guidance: fixed by 2 mm or by MM, adaptive by the 95 % "
        "quantile of the distance's uncertainty. In place of what a file says.",
        show_default="off",
    ),
]


def with_margin(fixtures: "FixtureSet", asked: str | float | None) -> "FixtureSet":
    """The fixtures with the margin that the user asked for, if so.

    Raises:
        InvalidInputError: no such margin, or a width out of range.
    """
    from dvf_ig.intake.fixtures import margin_options

    return fixtures if asked is None else replace(fixtures, margin=margin_options(asked))


def chosen_fixtures(
    given: Mapping[str, Any], file: Path | None, frame: str = "mr"
) -> "tuple[FixtureSet, RetimeMode | None]":
    """The fixtures that the user described, and the file's law of retiming where it gives one.

    Args:
        given: options of a single fixture by their keys in YAML (`dvf_ig.intake.fixtures`); None or False:
            not given.
        file: of several.
        frame: of the model.
    Raises:
        typer.BadParameter: options in addition to a file, or one that the law does not have.
        DvfIgError: a number out of range, or a file that does not fit.
    """
    from dvf_ig.guidance import FixtureSet
    from dvf_ig.intake.fixtures import LAWS, fixture_options, read_fixtures

    flags = _asked(given)
    if file is not None:
        if flags:
            raise typer.BadParameter(f"--fixtures describes every fixture; leave out {_options(flags)}")
        return read_fixtures(file, frame)
    law = flags.setdefault("law", "forbidden")
    unfit = [key for key in flags if key not in LAWS[law].model_fields]
    if unfit:
        fit = [key for key in given if key in LAWS[law].model_fields and key != "law"]
        raise typer.BadParameter(f"--law {law} does not take {_options(unfit)}; it takes {_options(fit)}")
    return FixtureSet((fixture_options(flags),)), None


def refuse_options(given: Mapping[str, Any], file: Path | None) -> None:
    """Raise typer.BadParameter if options describe fixtures that the session describes itself."""
    source = _options(_asked(given)) if file is None else "--fixtures"
    if source:
        raise typer.BadParameter(f"the session describes the fixtures; leave out {source}")


def _asked(given: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in given.items() if value is not None and value is not False}


def chosen_retiming(asked: "RetimeMode | None", of_file: "RetimeMode | None") -> "RetimeMode":
    """The law of retiming: the option's or the file's, else two-segment.

    Raises:
        typer.BadParameter: both are given.
    """
    if asked is not None and of_file is not None:
        raise typer.BadParameter(
            "the description of the fixtures gives the law of retiming; leave out --retiming"
        )
    return of_file or asked or "two-segment"


def _options(keys: Any) -> str:
    return ", ".join(f"--{key.replace('_', '-')}" for key in keys)
