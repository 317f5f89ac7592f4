"""Headings under which `dvf-ig register --help` lists its options."""

from typing import Any

from typer.core import TyperCommand

from .kinds import CALIBRATION, HEART, START

PANELS = {
    "Own recordings": {"--config", "--us", "--ecg", "--rate", "--ecg-start"} | CALIBRATION,
    "Gated 3-D volumes": {"--us-volume"},
    "Image pair": {"--fixed", "--moving", "--mask"},
    "Heart": HEART,
    "Start": START,
}


class RegisterCommand(TyperCommand):
    """A command whose options stand under PANELS, in their order; the others come first."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        for panel, listed in PANELS.items():
            for option in [param for param in self.params if param.opts[0] in listed]:
                vars(option)["rich_help_panel"] = panel
                self.params.remove(option)
                self.params.append(option)
