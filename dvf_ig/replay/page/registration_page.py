"""Page of a registration: outcome, evidence, findings and transform in words and numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import dvf_ig
from dvf_ig.core import HEART_RADIUS_MM, DvfModel, Landmarks
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.kernels.warp import LARGEST_SIGMA_MM
from dvf_ig.registration import RegistrationResult, least_constrained_direction
from dvf_ig.report.plane_overlay import PlaneOverlay
from dvf_ig.report.registration import Check, Outcome, RegistrationPage, Transform, registration_html
from dvf_ig.report.registration.shape import ShapeShown, shape_shown
from dvf_ig.report.viewer import RegistrationView, registration_payload, viewer_html

from .registration_checks import checks_of

CHANCE_CAVEAT = "chance that the mean error is below 2 mm: the share of synthetic hearts with such checks"
BOUND_CAVEAT = "95 of 100 synthetic hearts had no larger error anywhere in the box around the heart"


@dataclass(frozen=True, slots=True, eq=False)
class ShownInput:
    """The input of a registration, as its page shows it.

    Attributes:
        title: for example "Registration of case 7".
        about: whose it is, and from which files.
        source_name, target_name: what the two frames of the pose hold, as a reader calls it.
        anatomy: what the planes show of the pre-operative data in addition to contours, for example "MR".
        remark: what a reader should know about that; empty where nothing.
        planes: ultrasound planes before and after registration.
        data: rows of what was registered and how much of it was used.
        frames: how many were compared with the model; None for volumes and for a pair.
        frames_rejected: how many were not, by reason.
        model: of the heart; None for a pair.
        targets: named points of the model; None without any.
        tracked_against: what PLUS calls the frame that poses were relative to.
    """

    title: str
    about: str
    source_name: str
    target_name: str
    anatomy: str
    remark: str
    planes: Sequence[PlaneOverlay]
    data: Sequence[tuple[str, str]]
    frames: int | None = None
    frames_rejected: Mapping[str, int] = field(default_factory=dict)
    model: DvfModel | None = None
    targets: Landmarks | None = None
    tracked_against: str = "tracker"


def registration_page(
    result: RegistrationResult, shown: ShownInput, transform: Path, seed: int, view: str
) -> str:
    """Show a registration as an HTML page.

    Args:
        transform: the file that the pose is written to.
        seed: of its random choices.
        view: name of the interactive page in the same folder; empty without.
    """
    pose = result.target_from_source
    checks = checks_of(result)
    return registration_html(
        RegistrationPage(
            title=shown.title,
            about=f"{shown.about}, dvf_ig {dvf_ig.__version__}",
            usable=result.stop.usable,
            reason=_reason(result, checks),
            stated=stated_rows(result),
            planes=shown.planes,
            anatomy=shown.anatomy,
            remark=shown.remark,
            checks=checks,
            findings=_findings(result),
            data=shown.data,
            transform=Transform(
                pose.target, pose.source, shown.target_name, shown.source_name, pose.matrix, transform.name
            ),
            made=(
                ("computing time", f"{result.seconds:.1f} s"),
                ("slices, evaluations", f"{result.slices}, {result.evaluations}"),
                ("seed", str(seed)),
                ("threads", str(thread_count())),
            ),
            view=view,
            shape=_shape(result, shown.model),
        )
    )


def _shape(result: RegistrationResult, model: DvfModel | None) -> ShapeShown | None:
    """The surface in the MR and now, at end-diastole; None if no change was found, or for a pair."""
    change = result.shape
    if change is None or model is None:
        return None
    mesh = model.reference[model.ed_phase]
    return shape_shown(change.sentence, mesh, change.warp, LARGEST_SIGMA_MM)


def registration_view(result: RegistrationResult, shown: ShownInput) -> str | None:
    """Show a registration as an interactive HTML page; None without a plane that could be shown."""
    if not any(plane.anatomy_from_pixel is not None for plane in shown.planes):
        return None
    checks = checks_of(result)
    return viewer_html(
        registration_payload(
            RegistrationView(
                title=shown.title,
                patient_id=shown.about if shown.model is None else shown.model.patient_id,
                usable=result.stop.usable,
                reason=_reason(result, checks),
                rows=[*stated_rows(result), ("moved from the start", f"{result.moved_mm:.1f} mm")],
                planes=shown.planes,
                anatomy=shown.anatomy,
                model=shown.model,
                targets=shown.targets,
                bound_mm=result.tre_bound_mm,
                warp=None if result.shape is None else result.shape.warp,
            )
        )
    )


def _reason(result: RegistrationResult, checks: Sequence[Check]) -> str:
    failed = [c for c in checks if c.outcome is Outcome.FAILED]
    passed = [c for c in checks if c.outcome is Outcome.PASSED]
    if result.stop.usable:
        return f"It {result.sentence}, and passed all {len(passed)} checks that its kind of input allows."
    sentence = f"{result.sentence[0].upper()}{result.sentence[1:]}."
    if failed:
        named = "; ".join(f"{c.name.lower()} ({c.value}, needed {c.limit})" for c in failed)
        sentence += f" Failed: {named}."
    return sentence


def _findings(result: RegistrationResult) -> list[tuple[str, str, str]]:
    second = result.second_best
    elsewhere = f"the best pose found elsewhere has {second:.3f}" if second > 0 else "no other pose was found"
    turned_deg = np.degrees((result.target_from_source @ result.start.inverse()).angle_rad)
    return [
        (
            "similarity (LC2)",
            f"{result.start_similarity:.3f} at the start, {result.similarity:.3f} registered",
            f"share of the ultrasound's variation that the anatomy explains, 0 to 1; {elsewhere}",
        ),
        (
            "moved by",
            f"{result.moved_mm:.1f} mm, turned by {turned_deg:.1f}°",
            f"from the start pose to the registered one; mean over a ball of {HEART_RADIUS_MM:g} mm radius",
        ),
        ("standard deviation", _deviations(result), "L–R, A–P, S–I; by the similarity's curvature"),
        (
            "least constrained",
            least_constrained_direction(result.covariance).sentence(),
            "the direction in which the ultrasound determines the pose least",
        ),
        *(
            (*row, caveat)
            for row, caveat in zip(stated_rows(result), (CHANCE_CAVEAT, BOUND_CAVEAT), strict=True)
        ),
    ]


def stated_rows(result: RegistrationResult) -> list[tuple[str, str]]:
    """Describe success probability and error bound in words, or why there is none."""
    chance, bound = result.success_probability, result.tre_bound_mm
    why = result.outside or "not stated for a refused pose"
    unbounded = why if result.evidence.pair is None else "none was calibrated for pairs of organs"
    return [
        ("success probability", why if chance is None else f"{chance:.2f}"),
        ("largest error over the heart", unbounded if bound is None else f"below {bound:.1f} mm, at 95 %"),
    ]


def _deviations(result: RegistrationResult) -> str:
    if not np.isfinite(result.covariance).all():
        return "not determined"
    sd = np.sqrt(np.diag(result.covariance))
    turns, shifts = (", ".join(f"{v:.2f}" for v in part) for part in (np.degrees(sd[:3]), sd[3:]))
    return f"shifts {shifts} mm; turns about these axes {turns}°"
