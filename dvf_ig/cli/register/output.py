"""What `dvf-ig register` writes and prints, and the exit code of a pose that must not be used."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dvf_ig.core import Rigid
    from dvf_ig.registration import RegistrationResult

    Registered = tuple[RegistrationResult, Rigid]
    """What was found, and the pose it started from."""


def payload_of(result: "RegistrationResult", start: "Rigid", name: str, seed: int) -> dict[str, Any]:
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


def files_of(out: Path, name: str) -> tuple[Path, Path]:
    """Where the transform and its evidence go."""
    if out.suffix == ".tfm":
        return out, out.with_name(f"{out.stem}.result.json")
    return out / f"{name}.tfm", out / "result.json"


def rows_of(result: "RegistrationResult", name: str) -> list[tuple[str, str]]:
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


def require_usable(result: "RegistrationResult") -> None:
    from dvf_ig.core import NoOverlapError, NotConvergedError, QualityGateError, Stop

    if result.stop is Stop.MAX_ITERATIONS:
        raise NotConvergedError(f"the registration must not be used: {result.sentence}")
    if result.stop is Stop.LOW_OVERLAP:
        raise NoOverlapError(f"the registration must not be used: {result.sentence}")
    if not result.stop.usable:
        raise QualityGateError(f"the registration must not be used: {result.sentence}")
