"""Output of `dvf-ig register`: its files, its lines, and the exit code of a pose that must not be used."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dvf_ig.cli.shell import output_dir, output_file

if TYPE_CHECKING:
    from dvf_ig.registration import RegistrationResult, SurfaceDisagreement
    from dvf_ig.replay.page.registration_page import ShownInput


class OutputFiles(NamedTuple):
    """Where the transform, its evidence, its page and its interactive page go."""

    transform: Path
    evidence: Path
    page: Path
    view: Path
    shape: Path

    @property
    def plus_xml(self) -> Path:
        """Where a usable mr_from_tracker goes for PLUS, whose format cannot say that one was refused."""
        return self.transform.with_suffix(".xml")

    @property
    def every(self) -> tuple[Path, ...]:
        """All files that may be written."""
        transforms = (self.transform, *(self.transform.with_suffix(end) for end in (".h5", ".json")))
        return (*transforms, self.plus_xml, self.evidence, self.page, self.view, self.shape)

    def write(
        self, result: "RegistrationResult", shown: "ShownInput", payload: dict[str, Any], name: str
    ) -> None:
        """Write all of them or none, and print their names."""
        from dvf_ig.cli.shell import wrote
        from dvf_ig.io import files_together, write_registration, write_sidecar, write_text, write_transforms
        from dvf_ig.replay.outputs import write_shape
        from dvf_ig.replay.page.registration_page import registration_page, registration_view

        pose = result.target_from_source
        view = registration_view(result, shown)
        linked = "" if view is None else self.view.name
        page = registration_page(result, shown, self.transform, payload["seed"], linked)
        with files_together(self.transform.parent, [path.name for path in self.every]) as new:
            written = [*write_transforms(pose, new / self.transform.name)]
            if name == "mr_from_tracker" and result.stop.usable:
                written.append(
                    write_registration(replace(pose, source=shown.tracked_against), new / self.plus_xml.name)
                )
            write_sidecar(new / self.evidence.name, payload, "registration")
            write_text(new / self.page.name, page)
            if view is not None:
                write_text(new / self.view.name, view)
            if result.shape is not None:
                write_shape(result.shape.warp, new / self.shape.name)
        for file in written:
            wrote(self.transform.with_name(file.name), name)
        wrote(self.evidence)
        wrote(self.page)
        if view is not None:
            wrote(self.view)
        if result.shape is not None:
            wrote(self.shape, result.target_from_source.target)


def output_of_register(out: Path | None) -> Path | None:
    """Check -o, a folder or a `.tfm` file (typer callback)."""
    return output_file(out) if out is not None and out.suffix == ".tfm" else output_dir(out)


def payload_of(result: "RegistrationResult", shown: "ShownInput", name: str, seed: int) -> dict[str, Any]:
    """JSON of a registration: pose, evidence and its input; `name` is that of the transform."""
    from dvf_ig.kernels.compiled import thread_count
    from dvf_ig.replay import evidence_of

    return {
        name: result.target_from_source.matrix.tolist(),
        "start": result.start.matrix.tolist(),
        "stop": result.stop.name,
        "reason": result.sentence,
        **evidence_of(result),
        "frames": shown.frames,
        "frames_rejected": dict(shown.frames_rejected),
        "surface_points": _surface_points(result.touched),
        "threads": thread_count(),
        "seed": seed,
    }


def files_of(out: Path, name: str) -> OutputFiles:
    """The files of a folder, or next to a transform file that the user named."""
    from dvf_ig.replay.outputs import SHAPE

    if out.suffix == ".tfm":
        ends = ("result.json", "html", "view.html", SHAPE)
        return OutputFiles(out, *(out.with_name(f"{out.stem}.{end}") for end in ends))
    names = (f"{name}.tfm", "result.json", "report.html", "view.html", SHAPE)
    return OutputFiles(*(out / name for name in names))


def _surface_points(touched: "SurfaceDisagreement | None") -> dict[str, Any] | None:
    """Distance of touched points from the surface; None if none were touched."""
    if touched is None:
        return None
    return {
        "median_mm": touched.median_mm,
        "limit_mm": touched.limit_mm,
        "agrees": touched.agrees,
        "points": len(touched.distance_mm),
    }


def rows_of(result: "RegistrationResult", name: str) -> list[tuple[str, str]]:
    """Describe a registration for printing, one row a figure."""
    import numpy as np

    from dvf_ig.registration import least_constrained_direction
    from dvf_ig.replay.page.registration_page import stated_rows

    touched = result.touched
    sd = np.sqrt(np.diag(result.covariance))
    rotation, shift = np.degrees(sd[:3]), sd[3:]
    return [
        (name, " ".join(f"{v:.3f}" for v in result.target_from_source.matrix[:3].ravel())),
        ("outcome", result.sentence),
        *stated_rows(result),
        ("moved from start", f"{result.moved_mm:.1f} mm"),
        ("similarity", f"{result.start_similarity:.3f} at the start, {result.similarity:.3f} now"),
        *_checks(result),
        *_landmarks(result.landmarks_mm),
        *([] if touched is None else [("touched surface", touched.sentence)]),
        *([] if result.shape is None else [("change of shape", result.shape.sentence)]),
        ("overlap", _overlap(result)),
        ("standard deviation", f"{_triple(rotation)} deg, {_triple(shift)} mm (x, y, z)"),
        ("least constrained", least_constrained_direction(result.covariance).sentence()),
        ("time", f"{result.seconds:.1f} s, {result.evaluations} evaluations"),
    ]


def _landmarks(apart_mm: float | None) -> list[tuple[str, str]]:
    from dvf_ig.registration import LANDMARKS_MM

    if apart_mm is None:
        return []
    return [("touched landmarks", f"{apart_mm:.1f} mm from the pose (at most {LANDMARKS_MM:g})")]


def _overlap(result: "RegistrationResult") -> str:
    if result.coverage is not None:
        return result.coverage.advice
    of = "the fan" if result.evidence.pair is not None else f"{result.slices} slices' pixels"
    return f"{100 * result.overlap:.0f} % of {of}"


def _checks(result: "RegistrationResult") -> list[tuple[str, str]]:
    """How far apart the optima of subsets of the ultrasound, and of the boundary, lie."""
    evidence = result.evidence
    disagreements = (
        ("interleaved halves disagree by", evidence.split_half_mm),
        ("parts of the cycle disagree by", evidence.phase_mm),
        ("half-volumes disagree by", evidence.half_volume_mm),
        ("boundary and LC2 disagree by", evidence.boundary_mm),
    )
    pair = evidence.pair
    if pair is None:
        return [
            (name, "not determined" if value is None else f"{value:.2f} mm") for name, value in disagreements
        ]
    return [
        (disagreements[0][0], f"{evidence.split_half_mm:.2f} mm"),
        ("parts left out predict", f"{pair.jackknife_mm:.2f} mm"),
        ("starts that end here", f"{100 * pair.agreeing_starts:.0f} %"),
        ("next best pose explains", f"{100 * pair.next_best_share:.0f} % as much"),
        ("mirrored anatomy explains", f"{100 * pair.mirrored_share:.0f} % as much"),
    ]


def _triple(values: Any) -> str:
    return ", ".join(f"{v:.2f}" for v in values)


def require_usable(result: "RegistrationResult") -> None:
    """Raise unless the pose may be used: the error gives the exit code.

    Raises:
        NotConvergedError, NoOverlapError, QualityGateError: by why the registration stopped.
    """
    from dvf_ig.core import NoOverlapError, NotConvergedError, QualityGateError, Stop

    touched = result.touched
    sentence = f"the registration must not be used: {result.sentence}"
    if result.stop in (Stop.MAX_ITERATIONS, Stop.MOVED_TOO_FAR):
        raise NotConvergedError(sentence)
    if result.stop is Stop.LOW_OVERLAP:
        raise NoOverlapError(sentence)
    if result.stop is Stop.DISAGREEMENT and touched is not None and not touched.agrees:
        raise QualityGateError(f"{sentence}; {touched.sentence}")
    if not result.stop.usable:
        raise QualityGateError(sentence)
