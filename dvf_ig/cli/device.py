"""`dvf-ig device`: the haptic devices of this machine, and a soft ball or tissue to feel with one."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from dvf_ig.cli.shell import JsonFlag, command, emit, warn

if TYPE_CHECKING:
    from dvf_ig.guidance.devices import HeldDevice

app = typer.Typer(
    help="Haptic devices: what is there, and a soft ball or tissue to feel.", no_args_is_help=True
)
FEEL_S, SIMULATED_S = 20.0, 3.0


@app.command("list")
def list_devices(as_json: JsonFlag = False) -> None:
    """List the haptic devices that `serve --device` takes; of one that is missing, what to do."""
    with command():
        from dvf_ig.guidance.devices import NAMES, open_device, vendor_problem
        from dvf_ig.guidance.devices.catalogue import VENDORS

        devices: list[dict[str, Any]] = []
        for name in NAMES:
            problem = vendor_problem(name) if name in VENDORS else None
            if problem is not None:
                devices.append({"name": name, "problem": problem})
                continue
            with closing(open_device(name)) as device:
                devices.append({"name": name, "problem": None, **_facts(device)})
        rows = [(one["name"], one["problem"] or _sentence(one)) for one in devices]
        emit({"devices": devices}, rows, as_json=as_json)


@app.command("test")
def feel(
    device: Annotated[
        str, Option(help="force-dimension, openhaptics, simulated[:premium|:omni].")
    ] = "simulated",
    seconds: Annotated[
        float | None, Option(min=0.5, show_default="20; 3 of a simulated device", help="How long.")
    ] = None,
    model: Annotated[
        Path | None,
        Option(
            "--feel",
            metavar="MODEL",
            help="Feel the beating heart of this model instead: softness, friction and texture of its "
            "labels, by a table with sources. For training and planning; no session does it.",
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Feel a soft ball, 40 mm across and 0.6 N at most, 10 mm from the tip along the device's -x.

    Prints position, ticks and their lateness, time of a tick, latency, and forces. Hold the stylus loosely.
    """
    with command():
        from dvf_ig.guidance.devices import SimulatedStylus, open_device
        from dvf_ig.io import read_model
        from dvf_ig.study.soft_ball import feel_ball

        heart = None if model is None else read_model(model)
        with closing(open_device(device)) as hardware:
            simulated = isinstance(hardware, SimulatedStylus)
            if not simulated:
                what = "ball" if heart is None else "heart"
                typer.echo(f"push slowly along -x into the {what}; Ctrl-C ends", err=True)
            result = feel_ball(hardware, seconds or (SIMULATED_S if simulated else FEEL_S), heart)
        for sentence in result["cannot_render"]:
            warn(sentence)
        emit(result, _rows(result), as_json=as_json)


def _facts(device: "HeldDevice") -> dict[str, Any]:
    from dvf_ig.guidance.device import COMMON_DEVICE
    from dvf_ig.guidance.devices import limits_of, position_mm

    limits = limits_of(device, COMMON_DEVICE)
    return {
        "device": device.name,
        "position_mm": position_mm(device).tolist(),
        "rate_hz": device.rate_hz,
        "continuous_force_n": limits.continuous_force_n,
        "stiffness_n_per_m": limits.stiffness_n_per_m,
    }


def _sentence(one: dict[str, Any]) -> str:
    return (
        f"{one['device']} at {_point(one['position_mm'])} mm, {one['rate_hz']:.0f} Hz, up to "
        f"{one['continuous_force_n']:g} N and {one['stiffness_n_per_m']:.0f} N/m"
    )


def _point(xyz: list[float]) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in xyz) + ")"


def _properties(one: dict[str, Any]) -> str:
    k, b, friction = one["stiffness_n_per_mm"], one["damping_n_s_per_m"], one["friction"]
    return (
        f"{one['name']}: {k['value']:.3g} N/mm ({k['source']}), {b['value']:g} N·s/m ({b['source']}), "
        f"friction {friction['value']:g} ({friction['source']})"
    )


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    late, work, ends = result["lateness_us"], result["work_us"], result["ends_force_after_ms"]
    alone = "not stated" if ends is None else f"{ends:g} ms after the last command"
    reasons = "; ".join(result["reasons"])
    return [
        ("device", result["device"]),
        ("position", f"{_point(result['position_mm'])} mm, surface at {_point(result['touched_mm'])}"),
        *(("tissue", _properties(one)) for one in result["tissue"] or ()),
        ("ticks", f"{result['ticks']} at {result['rate_hz']:.0f} Hz, {result['run_share']:.2%} of all"),
        ("lateness", f"median {late['median']:.0f} us, p99 {late['p99']:.0f}, max {late['max']:.0f}"),
        ("time of a tick", f"median {work['median']:.1f} us, p99 {work['p99']:.1f}, with the device's calls"),
        ("latency", f"{result['latency_ms']:g} ms, as stated for the device"),
        ("force cap", f"{result['continuous_force_n']:g} N, {result['stiffness_n_per_m']:.0f} N/m"),
        ("ends its force alone", alone),
        ("felt", f"up to {result['largest_force_n']:.2f} N, {result['deepest_mm']:.1f} mm deep"),
        ("button", f"pressed {result['button_presses']} times"),
        ("state at the end", f"{result['state']}{': ' if reasons else ''}{reasons}"),
    ]
