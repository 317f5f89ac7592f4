"""`dvf-ig force`: forces of fixtures at given points and one phase."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from .fixture_options import FixturesFileOption, MarginOption, chosen_fixtures, takes_fixture, with_margin
from .shell import JsonFlag, command, emit, warn

if TYPE_CHECKING:
    from dvf_ig.core import FloatArray
    from dvf_ig.guidance import FixtureOptions, FixtureSet, ForceSamples


@takes_fixture
def force(
    model_file: Annotated[Path, Argument(metavar="MODEL", help="Model file.")],
    points: Annotated[
        Path,
        Option(
            help="Points in the model's frame, in mm: CSV of x,y,z (LPS; a header is allowed), or 3D "
            "Slicer's .mrk.json or .fcsv (LPS or RAS, as the file states)."
        ),
    ],
    phase: Annotated[float, Option(help="Phase of the model's cycle, 0 at the R peak, modulo 1.")],
    *,
    fixture: dict[str, Any],
    fixtures: FixturesFileOption = None,
    free_zone_mm: Annotated[
        float | None, Option(help="Guidance: choose --delta and --m for this zone …")
    ] = None,
    detection_threshold_n: Annotated[
        float,
        Option("--felt-below-n", help="… in which the force stays below this detection threshold, in N."),
    ] = 0.05,
    stiffness: Annotated[
        float | None,
        Option("--device-stiffness", help="Stiffest wall the device renders, in N/m.", show_default="400"),
    ] = None,
    damping: Annotated[
        float | None,
        Option(
            "--device-damping", help="Physical damping of the device in N·s/m; checks passivity at 1 kHz."
        ),
    ] = None,
    margin: MarginOption = None,
    sigma_mm: Annotated[
        float | None, Option(help="With --margin adaptive: standard deviation of the distance, in mm.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Evaluate dynamic fixtures; a point outside the model's box gets no force and status OUT_OF_VOLUME."""
    with command():
        if not math.isfinite(phase):
            raise typer.BadParameter(f"--phase is {phase}; needed a finite number")
        from dvf_ig.core import Rigid
        from dvf_ig.guidance import Fixtures
        from dvf_ig.io import read_model, read_points

        model = read_model(model_file)
        options, _ = chosen_fixtures(fixture, fixtures, model.frame)
        limits = dataclasses.replace(
            options.device,
            stiffness_n_per_m=options.device.stiffness_n_per_m if stiffness is None else stiffness,
            damping_n_s_per_m=damping,
        )
        options = dataclasses.replace(options, device=limits)
        if free_zone_mm is not None:
            if fixture["law"] != "guidance" or fixture["delta"] is not None or fixture["m"] is not None:
                raise typer.BadParameter(
                    "--free-zone-mm belongs to --law guidance and chooses its --delta and --m"
                )
            options = _with_free_zone(options, free_zone_mm, detection_threshold_n)
        options, margin_mm = _with_margin(with_margin(options, margin), sigma_mm)
        xyz_mm = read_points(points, model.frame).xyz_mm
        here = Rigid.identity(model.frame, model.frame)
        samples = Fixtures(model, options).evaluate(here, xyz_mm, phase)
        _print(samples, options, xyz_mm, margin_mm, as_json)


def _with_margin(options: "FixtureSet", sigma_mm: float | None) -> "tuple[FixtureSet, float]":
    """Widen the laws of fixtures by their margin, and return that margin in mm; a path keeps its law."""
    from dvf_ig.guidance.margins import NO_MARGIN, widened

    adaptive = options.margin.mode == "adaptive"
    if adaptive != (sigma_mm is not None):
        raise typer.BadParameter(
            "--margin adaptive needs --sigma-mm here: no session states the error of the distance"
            if adaptive
            else "--sigma-mm belongs to --margin adaptive"
        )
    margin_mm = options.margin.wanted_mm(math.nan if sigma_mm is None else sigma_mm)
    laws = [
        one if one.path is not None else dataclasses.replace(one, law=widened(one.law, margin_mm))
        for one in options.fixtures
    ]
    return dataclasses.replace(options, fixtures=tuple(laws), margin=NO_MARGIN), margin_mm


def _with_free_zone(
    options: "FixtureSet", half_width_mm: float, detection_threshold_n: float
) -> "FixtureSet":
    """Give the single fixture the width and the exponent that the zone needs."""
    from dvf_ig.guidance import FreeZone, gaussian_for_free_zone

    (one,) = options.fixtures
    zone = FreeZone(half_width_mm, detection_threshold_n)
    law = gaussian_for_free_zone(zone, cap_n=one.law.cap_n, depth_mm=one.law.depth_mm, device=options.device)
    warn(f"the free zone gives --delta {law.delta_mm:.4g} --m {law.m:g}")
    return dataclasses.replace(options, fixtures=(dataclasses.replace(one, law=law),))


def _felt(one: "FixtureOptions") -> str:
    """Describe where a fixture is felt."""
    law, name = one.law, one.name or "the fixture"
    if math.isinf(law.reach_mm):
        return f"{name} pulls from everywhere, by at most {law.cap_n:g} N"
    side, beyond = ("inside", "outside") if one.described().get("inside") else ("outside", "inside")
    where = f"{abs(law.reach_mm):.1f} mm {side if law.reach_mm >= 0.0 else beyond} the surface"
    return f"{name} is felt (1 % of {law.cap_n:g} N) from {where}"


def _print(
    samples: "ForceSamples", options: "FixtureSet", xyz_mm: "FloatArray", margin_mm: float, as_json: bool
) -> None:
    from dvf_ig.guidance import Status

    names = [Status(code).name for code in samples.status.tolist()]
    payload = {
        "force_n": samples.force_n.tolist(),
        "distance_mm": [d if math.isfinite(d) else None for d in samples.distance_mm.tolist()],
        "status": names,
        "frame": samples.frame,
        "margin_mm": margin_mm,
        "reach_mm": [
            one.law.reach_mm if math.isfinite(one.law.reach_mm) else None for one in options.fixtures
        ],
    }
    for one in () if as_json else options.fixtures:
        typer.echo(_felt(one), err=True)
    rows = [("x y z (mm)", "force x y z (N)         distance (mm)  status")]
    for point, push, distance, name in zip(xyz_mm, samples.force_n, samples.distance_mm, names, strict=True):
        where = " ".join(f"{c:8.2f}" for c in point)
        rows.append((where, " ".join(f"{c:7.3f}" for c in push) + f"  {distance:12.3f}  {name}"))
    emit(payload, rows, as_json=as_json)
