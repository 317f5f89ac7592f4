"""`dvf-ig study passivity`: a wall steeper than the device renders, and a wall that beats."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, wrote

if TYPE_CHECKING:
    from dvf_ig.study.passivity.cases import BeatingCase, WallCase


def passivity(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", callback=output_dir, help="Folder for passivity.json.")
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=2.0, help="Length of a push.")] = 20.0,
    as_json: JsonFlag = False,
) -> None:
    """Motion of a stylus pushed against a wall of three times the passive γ, without and with the controller.

    Also the work that a beating wall does on a hand, a cycle. Simulated devices; nothing is random.
    """
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.io.json_file import plain
        from dvf_ig.study.passivity.cases import beating_walls, steep_walls

        walls, beating = steep_walls(seconds), beating_walls()
        result = {"steep_walls": plain(walls), "beating_walls": plain(beating)}
        if out is not None:
            with output_folder(out, ["passivity.json"]):
                write_json(out / "passivity.json", result)
        emit(result, [*_wall_rows(walls), *_beating_rows(beating)], as_json=as_json)
        if out is not None:
            wrote(out / "passivity.json")


def _wall_rows(walls: "list[WallCase]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("device", "γ of limit, 1/mm", "RMS mm without", "with", "5 mJ after s", "residual mJ with")
    ]
    for wall in walls:
        d = wall.device
        device = (
            f"{d.name}: {1000 * d.mass_kg:g} g, b {d.viscous_n_s_per_m:g} N·s/m, dry {d.dry_n:g} N, step "
            f"{d.resolution_mm:g} mm, delay {1000 * wall.delay_s:g} ms, {d.rate_hz:g} Hz"
        )
        gamma = f"{wall.gamma_per_mm:.2f} of {wall.limit_per_mm:.2f}"
        numbers = (wall.without_mm, wall.with_mm, wall.limit_reached_s, wall.largest_residual_mj)
        rows.append((device, gamma, *(f"{value:.4f}" for value in numbers)))
    return rows


def _beating_rows(beating: "list[BeatingCase]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("hand at a beating wall", "by surface mJ a cycle", "most", "in all", "", "")
    ]
    for case in beating:
        numbers = (case.by_surface_mj, case.largest_by_surface_mj, case.given_mj)
        rows.append((case.hand, *(f"{value:.3f}" for value in numbers), "", ""))
    return rows
