"""The examples under `--help`, a command each; a test parses every one."""

import typer

OWN = "--model heart.npz --probe probe.json --latency latency.json"

EXAMPLES: dict[str, tuple[str, ...]] = {
    "doctor": ("dvf-ig doctor", "dvf-ig doctor --json"),
    "inspect": ("dvf-ig inspect ultrasound.igs.mha", "dvf-ig inspect heart.npz --json"),
    "force": (
        "dvf-ig force heart.npz --points points.csv --phase 0.35",
        "dvf-ig force heart.npz --points points.csv --phase 0.35 --law guidance --delta 3 --m 1",
    ),
    "gate": (
        "dvf-ig gate edf:ecg.edf -o gating.json",
        "dvf-ig gate plus:ultrasound.igs.mha --phase-at 50",
    ),
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
    ),
    "synth stream": ("dvf-ig synth stream demo", "dvf-ig synth stream demo --port 18945 --speed 0.5"),
    "bench": ("dvf-ig bench", "dvf-ig bench --servo 60"),
    "view": ("dvf-ig view run", "dvf-ig view run -o run.html --recording demo"),
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
    "config init": (
        "dvf-ig config init --us ultrasound.igs.mha --ecg edf:ecg.edf -o session.yaml",
        f"dvf-ig config init --us ultrasound.igs.mha --ecg edf:ecg.edf {OWN} "
        "--landmarks landmarks_mr.mrk.json landmarks_tracker.mrk.json --tool tool.igs.mha --tip tip.json "
        "-o session.yaml",
        "dvf-ig config init --us-volume ed.nrrd@0.0 --us-volume es.nrrd@0.35 --model heart.npz "
        "--mr cine.nrrd --start start.tfm -o session.yaml",
    ),
    "config dump": ("dvf-ig config dump session.yaml", "dvf-ig config dump demo"),
    "config validate": (
        "dvf-ig config validate session.yaml",
        "dvf-ig config validate session.yaml --for replay",
    ),
}
"""By the command's name."""


def show_examples(app: typer.Typer, before: str = "") -> None:
    """Put the examples of every command of an application, and of its groups, under its help.

    Raises:
        KeyError: a command has none.
    """
    for group in app.registered_groups:
        if group.typer_instance is not None:
            show_examples(group.typer_instance, f"{before}{group.name} ")
    for command in app.registered_commands:
        examples = EXAMPLES[f"{before}{command.name}"]
        command.epilog = "\n\n".join(("Examples:" if len(examples) > 1 else "Example:", *examples))
