"""Help of commands and groups: their sections, and examples that a test parses."""

import inspect
from collections.abc import Sequence

import typer

OWN = "--model heart.npz --probe probe.json --latency latency.json"

EXAMPLES: dict[str, tuple[str, ...]] = {
    "cache": ("dvf-ig cache", "dvf-ig cache --clear"),
    "doctor": ("dvf-ig doctor", "dvf-ig doctor --json"),
    "inspect": ("dvf-ig inspect ultrasound.igs.mha", "dvf-ig inspect heart.npz --json"),
    "force": (
        "dvf-ig force heart.npz --points points.csv --phase 0.35",
        "dvf-ig force heart.npz --points points.csv --phase 0.35 --law guidance --delta 3 --m 1",
    ),
    "gate": ("dvf-ig gate edf:ecg.edf -o gating.json", "dvf-ig gate plus:ultrasound.igs.mha --phase-at 50"),
    "register": (
        "dvf-ig register demo -o registration",
        "dvf-ig register session.yaml -o registration",
        "dvf-ig register --fixed ultrasound.nii.gz --moving t1.nii.gz --moving flair.nii.gz -o registration",
    ),
    "evaluate": ("dvf-ig evaluate --transform registration.tfm --landmarks fixed.mrk.json moving.mrk.json",),
    "replay": (
        "dvf-ig replay demo -o run",
        "dvf-ig replay session.yaml -o run --margin adaptive",
        "dvf-ig replay session.mcap -o again",
        "dvf-ig replay demo -o run --law guidance --delta 3 --m 1 --retiming uniform",
    ),
    "serve": (
        "dvf-ig serve session.yaml",
        "dvf-ig serve session.yaml --host 192.0.2.7 --allow 192.0.2.7 --page 8080",
        "dvf-ig serve demo --seconds 70 --json",
        "dvf-ig serve demo --device simulated:omni --page 8080",
        "dvf-ig serve session.yaml --device force-dimension -o run",
    ),
    "device list": ("dvf-ig device list",),
    "device test": ("dvf-ig device test", "dvf-ig device test --device force-dimension --seconds 30"),
    "synth stream": ("dvf-ig synth stream demo", "dvf-ig synth stream demo --port 18945 --speed 0.5"),
    "bench": ("dvf-ig bench", "dvf-ig bench --servo 60"),
    "view": ("dvf-ig view run", "dvf-ig view heart.npz", "dvf-ig view run -o run.html --recording demo"),
    "export slicer": (
        "dvf-ig export slicer run -o scene",
        "dvf-ig export slicer registration --recording session.yaml -o scene",
    ),
    "export mcap": ("dvf-ig export mcap run -o session.mcap",),
    "export rerun": ("dvf-ig export rerun run -o session.rrd",),
    "synth scenario": (
        "dvf-ig synth scenario --preset calm --motion paper5mm --seconds 60 --seed 1 -o demo",
        "dvf-ig synth scenario --preset lost-ultrasound --heart varied --seed 2 -o demo",
        "dvf-ig synth scenario --anatomy cine --cine mr.nrrd --labels ed.nrrd --es-labels es.nrrd@9 -o demo",
    ),
    "synth us": ('dvf-ig synth us --labels heart.nii.gz --view "tee four-chamber" -o ultrasound',),
    "synth calibration": ("dvf-ig synth calibration nwire --seed 1 -o nwire",),
    "model build": (
        "dvf-ig model build --image cine.nrrd --labels ed.nrrd --cavity 3,1 -o heart.npz",
        "dvf-ig model build --surfaces surfaces --surface EPICARDIAL -o heart.npz",
    ),
    "model check": ("dvf-ig model check heart.npz", "dvf-ig model check heart.npz --labels es.nii.gz@0.35"),
    "model export": ("dvf-ig model export heart.npz --format stl -o surfaces",),
    "train": (
        "dvf-ig train cutting --device simulated",
        "dvf-ig train dissection --device force-dimension --person anna --trials 5 -o training",
    ),
    "calibrate pivot": ("dvf-ig calibrate pivot pivot.igs.mha -o tip.json",),
    "calibrate probe": (
        "dvf-ig calibrate probe nwire.igs.mha --device-set PlusDeviceSet.xml -o probe.json",
        "dvf-ig calibrate probe cross-wire.igs.mha --phantom cross-wire --points crossing.csv -o probe.json",
    ),
    "calibrate latency": ("dvf-ig calibrate latency tracker.igs.mha video.igs.mha -o latency.json",),
    "calibrate landmarks": (
        "dvf-ig calibrate landmarks stylus.igs.mha --device-set PlusDeviceSet.xml -o phantom.json",
    ),
    "calibrate hand-eye": ("dvf-ig calibrate hand-eye robot.csv camera.csv -o hand_from_camera.json",),
    "calibrate device": (
        "dvf-ig calibrate device corners.mrk.json --device force-dimension -o device.json",
        "dvf-ig calibrate device corners.mrk.json --touched touched.mrk.json -o device.json",
    ),
    "config init": (
        "dvf-ig config init --us ultrasound.igs.mha --ecg edf:ecg.edf -o session.yaml",
        f"dvf-ig config init --us ultrasound.igs.mha --ecg edf:ecg.edf {OWN} "
        "--landmarks landmarks_mr.mrk.json landmarks_tracker.mrk.json --tool tool.igs.mha --tip tip.json "
        "-o session.yaml",
        "dvf-ig config init --us-volume ed.nrrd@0.0 --us-volume es.nrrd@0.35 --model heart.npz "
        "--mr cine.nrrd --start start.tfm -o session.yaml",
    ),
    "config schema": ("dvf-ig config schema -o session.schema.json",),
    "config dump": ("dvf-ig config dump session.yaml", "dvf-ig config dump demo"),
    "config validate": (
        "dvf-ig config validate session.yaml",
        "dvf-ig config validate session.yaml --for replay",
    ),
}
"""Examples by the command's name."""

FIRST = (
    "dvf-ig synth scenario --preset calm --motion paper5mm --seconds 30 --seed 101 -o demo",
    "dvf-ig replay demo -o run",
    "dvf-ig view run",
)
"""Examples of the whole program: three lines from nothing to a heart that beats on the screen."""

SECTIONS = {
    "Prepare": ("inspect", "calibrate", "gate", "model", "config"),
    "Intervene": ("register", "evaluate", "replay", "serve", "force"),
    "Look, and hand on": ("view", "export"),
    "Try and measure": ("synth", "train", "study", "bench"),
    "This machine": ("doctor", "device", "cache"),
}
"""Commands and groups by heading, in the order of an intervention."""


def show_examples(app: typer.Typer) -> None:
    """Put examples under the help of the program, its groups and their commands, and sort it by section.

    Help is also freed from the line breaks of docstrings, which the terminal's width does not share.

    Raises:
        KeyError: a command has no examples, or no section.
    """
    section = {name: heading for heading, names in SECTIONS.items() for name in names}
    order = list(section)
    app.info.epilog = _epilog(FIRST)
    app.registered_commands.sort(key=lambda command: order.index(str(command.name)))
    for command in app.registered_commands:
        command.rich_help_panel = section[str(command.name)]
    for group in app.registered_groups:
        group.rich_help_panel = section[str(group.name)]
    _show_examples(app, "")


def _show_examples(app: typer.Typer, before: str) -> None:
    for group in app.registered_groups:
        inner = group.typer_instance
        if inner is not None and inner.registered_commands:
            _show_examples(inner, f"{group.name} ")
            names = [f"{group.name} {command.name}" for command in inner.registered_commands]
            group.epilog = _epilog([EXAMPLES[name][0] for name in names])
    for command in app.registered_commands:
        command.epilog = _epilog(EXAMPLES[f"{before}{command.name}"])
        paragraphs = (inspect.getdoc(command.callback) or "").split("\n\n")
        command.help = "\n\n".join(" ".join(text.split()) for text in paragraphs)


def _epilog(examples: Sequence[str]) -> str:
    return "\n\n".join(("Examples:" if len(examples) > 1 else "Example:", *examples))
