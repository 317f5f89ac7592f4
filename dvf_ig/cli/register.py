"""`dvf-ig register`: where the patient is, from gated ultrasound or from a pair of images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .patient_model import patient_model
from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, wrote

if TYPE_CHECKING:
    from dvf_ig.core import Rigid
    from dvf_ig.registration import RegistrationResult

    Registered = tuple[RegistrationResult, Rigid]
    """What was found, and the pose it started from."""


def register(
    scenario: Annotated[
        Path | None, typer.Argument(help="Scenario folder; or give --fixed and --moving.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder, or a .tfm file, for the transform.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
    ] = None,
    fixed: Annotated[Path | None, typer.Option("--fixed", help="3-D ultrasound image.")] = None,
    moving: Annotated[Path | None, typer.Option("--moving", help="3-D MR or CT image.")] = None,
    init: Annotated[Path | None, typer.Option("--init", help="Start pose, ITK .tfm.")] = None,
    mask: Annotated[Path | None, typer.Option("--mask", help="Mask on the fixed image's grid.")] = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Register ultrasound to the pre-operative model, and say whether the result may be used.

    A scenario gives mr_from_tracker from its gated, tracked frames; an image pair gives moving_from_fixed.
    The evidence is written in any case; exits 5, 6 or 7 when the pose must not be used.
    """
    with command(threads):
        from dvf_ig.io import output_folder, refuse_foreign, write_sidecar, write_transforms

        if out is None:
            raise typer.BadParameter("say where to write: -o OUT")
        if (scenario is None) == (fixed is None and moving is None):
            raise typer.BadParameter("give either a scenario folder, or --fixed US and --moving MR")
        if scenario is None and model is not None:
            raise typer.BadParameter("--model belongs to a scenario folder; an image pair has no model")
        name = "mr_from_tracker" if scenario is not None else "moving_from_fixed"
        transform, evidence = _files(out, name)
        with output_folder(transform.parent):
            refuse_foreign(evidence, kind="registration")
            refuse_foreign(transform.with_suffix(".json"), kind="transform")
            if scenario is not None:
                result, start = _scenario(scenario, model, init, seed)
            else:
                result, start = _pair(fixed, moving, init, mask, seed)
            payload = _payload(result, start, name, seed)
            for file in write_transforms(result.target_from_source, transform):
                wrote(file, name)
            write_sidecar(evidence, payload, "registration")
        wrote(evidence)
        emit(payload, _rows(result, name), as_json=as_json)
        _judge(result)


def _scenario(folder: Path, model: Path | None, init: Path | None, seed: int) -> "Registered":
    from dvf_ig.io import read_scenario, read_transform
    from dvf_ig.replay import register_scenario
    from dvf_ig.replay.start import start_pose

    given = read_transform(init, target="mr", source="tracker") if init is not None else None
    recorded = read_scenario(folder)
    start = given or start_pose(recorded)
    built, origin = patient_model(recorded.preop, model)
    with progress("register") as report:
        result = register_scenario(recorded, start, model=built, seed=seed, progress=report)
    typer.echo(origin, err=True)
    return result, start


def _pair(
    fixed: Path | None, moving: Path | None, init: Path | None, mask: Path | None, seed: int
) -> "Registered":
    from time import perf_counter

    import numpy as np

    from dvf_ig.core import Rigid
    from dvf_ig.io import read_transform, read_volume
    from dvf_ig.registration import register_pair

    if fixed is None or moving is None:
        raise typer.BadParameter("an image pair needs both --fixed US and --moving MR")
    ultrasound, anatomy = read_volume(fixed, frame="fixed"), read_volume(moving, frame="moving")
    start = (
        read_transform(init, target="moving", source="fixed")
        if init is not None
        else Rigid.identity("moving", "fixed")
    )
    allowed = read_volume(mask, frame="fixed") if mask is not None else None
    with progress("register") as report:
        result = register_pair(
            ultrasound,
            anatomy,
            start,
            rng=np.random.default_rng(seed),
            clock=perf_counter,
            mask=allowed,
            progress=report,
        )
    return result, start


def _payload(result: "RegistrationResult", start: "Rigid", name: str, seed: int) -> dict[str, Any]:
    from dvf_ig.kernels.compiled import thread_count
    from dvf_ig.replay import evidence_of

    return {
        name: result.target_from_source.matrix.tolist(),
        "start": start.matrix.tolist(),
        "stop": result.stop.name,
        "reason": result.sentence,
        **evidence_of(result),
        "threads": thread_count(),
        "seed": seed,
    }


def _files(out: Path, name: str) -> tuple[Path, Path]:
    """Where the transform and its evidence go."""
    if out.suffix == ".tfm":
        return out, out.with_name(f"{out.stem}.result.json")
    return out / f"{name}.tfm", out / "result.json"


def _rows(result: "RegistrationResult", name: str) -> list[tuple[str, str]]:
    import numpy as np

    from dvf_ig.registration import least_constrained_direction

    sd = np.sqrt(np.diag(result.covariance))
    rotation, shift = np.degrees(sd[:3]), sd[3:]
    return [
        (name, " ".join(f"{v:.3f}" for v in result.target_from_source.matrix[:3].ravel())),
        ("outcome", result.sentence),
        ("success probability", f"{result.success_probability:.2f}"),
        ("moved from start", f"{result.moved_mm:.1f} mm"),
        ("similarity", f"{result.start_similarity:.3f} at the start, {result.similarity:.3f} now"),
        *_checks(result),
        ("overlap", f"{100 * result.overlap:.0f} % of {result.slices} slices' pixels"),
        ("standard deviation", f"{_triple(rotation)} deg, {_triple(shift)} mm (x, y, z)"),
        ("least constrained", least_constrained_direction(result.covariance).sentence()),
        ("time", f"{result.seconds:.1f} s, {result.evaluations} evaluations"),
    ]


def _checks(result: "RegistrationResult") -> list[tuple[str, str]]:
    """How far apart the optima of subsets of the ultrasound, and of the boundary, lie."""
    evidence = result.evidence
    disagreements = (
        ("interleaved halves disagree by", evidence.split_half_mm),
        ("parts of the cycle disagree by", evidence.phase_mm),
        ("half-volumes disagree by", evidence.half_volume_mm),
        ("boundary and LC2 disagree by", evidence.boundary_mm),
    )
    return [(name, f"{value:.2f} mm") for name, value in disagreements if value is not None]


def _triple(values: Any) -> str:
    return ", ".join(f"{v:.2f}" for v in values)


def _judge(result: "RegistrationResult") -> None:
    from dvf_ig.core import NoOverlapError, NotConvergedError, QualityGateError, Stop

    if result.stop is Stop.MAX_ITERATIONS:
        raise NotConvergedError(f"the registration must not be used: {result.sentence}")
    if result.stop is Stop.LOW_OVERLAP:
        raise NoOverlapError(f"the registration must not be used: {result.sentence}")
    if not result.stop.usable:
        raise QualityGateError(f"the registration must not be used: {result.sentence}")
