"""SESSION, the argument of `register`, `replay` and `serve`, and what takes the place of dropped options."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option
from typer.core import TyperCommand

from .shell import progress

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Preop
    from dvf_ig.intake.findings import Finding
    from dvf_ig.intake.parts import SessionFiles
    from dvf_ig.intake.problems import Use

SESSION = "a scenario folder (see `dvf-ig synth scenario`) or a session.yaml (see `dvf-ig config init`)"
ModelOption = Annotated[
    Path | None,
    Option("--model", help="This patient's model for a scenario folder, which names none itself."),
]


class SessionCommand(TyperCommand):
    """A command that takes SESSION; an option that only repeated one of its keys is answered with the key."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        spellings = {name for param in self.get_params(ctx) for name in param.opts}
        for word in args:
            option = word.partition("=")[0]
            if option.startswith("--") and option not in spellings:
                _answer(option, f"dvf-ig {self.name}")
        return super().parse_args(ctx, args)


def _answer(option: str, command: str) -> None:
    """Say what takes the place of an option that was dropped; others are left to the parser."""
    from dvf_ig.intake.schema import KEYS

    if option == "--config":
        raise typer.BadParameter(
            f"there is no option --config; give the file as the argument: {command} session.yaml"
        )
    if option == "--feel":
        raise typer.BadParameter(
            "a session guides a patient and gives no force that is made up; feel the tissue of a model with: "
            "dvf-ig device test --feel MODEL"
        )
    for name, key in KEYS.items():
        if option in key.options:
            raise typer.BadParameter(
                f"{option} is the key {name} of a session.yaml: dvf-ig config init … {key.options[0]} "
                f"{key.metavar} -o session.yaml, then {command} session.yaml"
            )


def read_agreeing(
    session: Path, model: Path | None, use: "Use"
) -> "tuple[SessionFiles, tuple[Finding, ...]]":
    """A session whose files fit each other for a use, and what is doubtful about them.

    Raises:
        DvfIgError: the first reason why they cannot be used, or not together.
        typer.BadParameter: a model for a session.yaml, which names its own.
    """
    from dvf_ig.intake import read_session
    from dvf_ig.intake.fit import require_fit

    require_own_model(session, model)
    files = read_session(session)
    return files, () if session.suffix == ".mcap" else require_fit(files, use)


def require_own_model(session: Path, model: Path | None) -> None:
    """Refuse --model for a session.yaml, which names its heart.

    Raises:
        typer.BadParameter: says the key, and the line that sets it.
    """
    if model is not None and session.is_file() and session.suffix != ".mcap":
        raise typer.BadParameter(
            f"{session} says whose model it is (preop.model): dvf-ig config init … --model FILE -o {session}"
        )


def patient_model(preop: "Preop", given: "DvfModel | Path | None") -> "tuple[DvfModel, str]":
    """The given model or the one in a file, else from the cache or built; and one line that says so."""
    from dvf_ig.core import DvfModel
    from dvf_ig.intake import cached_model
    from dvf_ig.io import read_model

    if isinstance(given, DvfModel):
        return given, f"model of patient {given.patient_id}"
    if given is not None:
        return read_model(given, patient_id=preop.patient_id), f"model from {given}"
    with progress("model") as report:
        cached = cached_model(preop, progress=report)
    return cached.model, cached.remark
