"""The dynamic fixture model from closed surfaces: signed distance, then a spline fit, phase by phase."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import (
    LV_CAVITY,
    BoolArray,
    Chamber,
    CycleTiming,
    DvfModel,
    FloatArray,
    Grid,
    InvalidInputError,
    Mesh,
    Preop,
    Progress,
    SurfaceSeries,
    Volume,
    VolumeSeries,
    untold,
)
from dvf_ig.core.plausible import heart_problem
from dvf_ig.core.progress import thread_pool
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.preop.spline.fit import axis_solvers, fit_phase, sample_grid
from dvf_ig.preop.surface.chambers import chambers_from_labels, chambers_from_surfaces, label_name
from dvf_ig.preop.surface.closing import Cap, caps_of, close_surface, describe_caps
from dvf_ig.preop.surface.from_labels import border_caps, surfaces_from_labels
from dvf_ig.preop.surface.topology import count_edges
from dvf_ig.preop.surface.walls import labels_with_walls

from .knots import choose_knot_spacing
from .tissue import tissue_of_labels

log = logging.getLogger(__name__)

FLAT, FLAT_SHARE = 0.05, 0.12
"""Share of the stroke within which volumes count as the smallest, and share of the cycle from which on they
are flat: around end-systole a curve of one minimum stays so low over a tenth of the cycle."""


@dataclass(frozen=True, slots=True)
class ModelOptions:
    """Options of the model fit.

    Attributes:
        knot_spacing_mm: knot pitch.
        margin_mm: distance of the box's border from the volume that the surface sweeps; at 15 mm a sigmoid of
            1/mm has fallen to 3e-7 of its cap.
        band_mm: distance from the surface within which every sample is exact.
        threads: phases fitted at a time; has no influence on the result.
        accuracy_mm: required mean surface error; the pitch is then chosen on one phase (see
            `choose_knot_spacing`) and knot_spacing_mm is not used.
    """

    knot_spacing_mm: float = 3.0
    margin_mm: float = 15.0
    band_mm: float = 3.0
    threads: int = 2
    accuracy_mm: float | None = None

    def __post_init__(self) -> None:
        if not 0.5 <= self.knot_spacing_mm <= 20.0:
            raise InvalidInputError(f"knot spacing is {self.knot_spacing_mm:g} mm; needed 0.5 to 20 mm")
        if not 0.0 <= self.margin_mm <= 100.0:
            raise InvalidInputError(f"margin is {self.margin_mm:g} mm; needed 0 to 100 mm")
        if not self.band_mm > 0.0:
            raise InvalidInputError(f"band is {self.band_mm:g} mm; it must be positive")
        if self.threads < 1:
            raise InvalidInputError(f"{self.threads} threads requested; needed at least 1")
        if self.accuracy_mm is not None and not 0.001 <= self.accuracy_mm <= 1.0:
            raise InvalidInputError(f"the wanted accuracy is {self.accuracy_mm:g} mm; needed 0.001 to 1 mm")


def build_model(
    reference: Sequence[Mesh],
    caps: Sequence[BoolArray],
    timing: CycleTiming,
    *,
    patient_id: str,
    surface_name: str,
    frame: str = "mr",
    cavity_mm3: FloatArray | None = None,
    options: ModelOptions = ModelOptions(),
    progress: Progress | None = None,
    sources: Sequence[str] = (),
    chambers: Sequence[Chamber] = (),
) -> DvfModel:
    """Fit one cubic spline of signed distance per phase, all on one grid.

    Args:
        reference: closed surfaces, outward orientation, one a phase, in `frame`; their triangles may differ.
        caps: per phase, (t,) True for triangles that close an opening and were not measured.
        timing: phase times.
        cavity_mm3: (n,) left ventricular volume, from which end-diastole and end-systole are found; None uses
            the enclosed volume.
        progress: called with the fraction done.
        sources: provenance recorded in the model.
        chambers: chambers of blood, kept in the model unchanged.
    Raises:
        InvalidInputError: counts that do not match the timing, a surface that is not closed, or a required
            accuracy that no pitch reaches.
        FrameMismatchError: a surface in another frame.
    Source: Ren 2008, Section III, with exact distances instead of dilation, and the minimiser of eq. 2 with
        larger weights near the surface.
    """
    _check_reference(reference, timing, frame, surface_name)
    if options.accuracy_mm is not None:
        choice = choose_knot_spacing(
            reference, caps, options.accuracy_mm, margin_mm=options.margin_mm, band_mm=options.band_mm
        )
        options = replace(options, knot_spacing_mm=choice.knot_spacing_mm)
    grid = sample_grid(reference, frame, options.knot_spacing_mm, options.margin_mm)
    coefficients = _fit_phases(reference, grid, options, progress or untold)
    enclosed = np.array([mesh.volume_mm3() for mesh in reference])
    volumes = enclosed if cavity_mm3 is None else cavity_mm3
    return DvfModel(
        patient_id=patient_id,
        surface_name=surface_name,
        frame=frame,
        timing=timing,
        es_fraction=end_systole(volumes, timing.fractions),
        ed_phase=int(volumes.argmax()),
        coefficients=coefficients,
        origin_mm=grid.origin_mm,
        knot_spacing_mm=options.knot_spacing_mm,
        reference=tuple(reference),
        reference_caps=tuple(caps),
        sources=tuple(sources),
        chambers=tuple(chambers),
    )


def end_systole(volumes: FloatArray, fractions: FloatArray) -> float:
    """Fraction of the cycle at which a volume is smallest; the middle of where it long stays so."""
    smallest, n = int(volumes.argmin()), len(volumes)
    low = np.roll(volumes <= volumes.min() + FLAT * np.ptp(volumes), -smallest)
    if low.all():
        return float(fractions[smallest])
    after, before = int(low.argmin()) - 1, int(low[::-1].argmin())
    first = fractions[smallest - before]
    span = (fractions[(smallest + after) % n] - first) % 1.0
    flat = after + before > 1 and span >= FLAT_SHARE
    return float((first + 0.5 * span) % 1.0 if flat else fractions[smallest])


def _fit_phases(
    reference: Sequence[Mesh], grid: Grid, options: ModelOptions, report: Progress
) -> NDArray[np.float32]:
    """Fit (n, cx, cy, cz) coefficients, several phases at a time."""
    solvers = axis_solvers(grid)

    def fit(mesh: Mesh) -> NDArray[np.float32]:
        return fit_phase(mesh, grid, solvers, options.band_mm).astype(np.float32)

    coefficients = []
    with thread_pool(options.threads) as pool:
        for fitted in pool.map(fit, reference):
            coefficients.append(fitted)
            report(len(coefficients) / len(reference))
    return np.stack(coefficients)


def model_from_surfaces(
    series: SurfaceSeries,
    *,
    others: Sequence[SurfaceSeries] = (),
    options: ModelOptions = ModelOptions(),
    progress: Progress | None = None,
    sources: Sequence[str] = (),
) -> DvfModel:
    """Close a surface series and build its model.

    Args:
        others: surfaces of the same heart at the same phases: LV_ENDOCARDIAL and RV_ENDOCARDIAL become the
            model's chambers, and the volume of the left ventricle gives end-diastole and end-systole.
    Raises:
        InvalidInputError: a surface that cannot be closed, or other phase times.
    """
    for other in others:
        if not np.array_equal(other.timing.fractions, series.timing.fractions):
            raise InvalidInputError(f"surfaces {series.name} and {other.name} have different phase times")
    closed = close_surface(series)
    caps = caps_of(closed.vertices_mm[0], closed.triangles, closed.caps)
    chambers = chambers_from_surfaces(others)
    ventricle = next((c for c in chambers if c.name == LV_CAVITY), None)
    phases = range(len(closed.timing))
    return build_model(
        [closed.phase(i) for i in phases],
        [closed.caps for _ in phases],
        closed.timing,
        patient_id=closed.patient_id,
        surface_name=closed.name,
        frame=closed.frame,
        cavity_mm3=None if ventricle is None else np.array([m.volume_mm3() for m in ventricle.surfaces]),
        options=options,
        progress=progress,
        sources=(*sources, *_marked(closed.name, caps)),
        chambers=chambers,
    )


STILL_TIMING = CycleTiming(np.array([0.0, 0.5]), 1.0)
"""Phases of a structure that does not beat: two equal ones."""


def still_series(labels: Volume) -> VolumeSeries:
    """Repeat the labels of a structure that does not beat in both of its phases."""
    return VolumeSeries(labels.grid, np.stack([labels.values] * 2), STILL_TIMING)


def model_of_still(
    mesh: Mesh,
    *,
    patient_id: str,
    surface_name: str,
    options: ModelOptions = ModelOptions(),
    progress: Progress | None = None,
    sources: Sequence[str] = (),
) -> DvfModel:
    """Close the surface of a structure that does not beat and build its model: two equal phases.

    Raises:
        InvalidInputError: a surface that cannot be closed, or of no possible size.
    """
    vertices = np.stack([mesh.vertices_mm] * 2)
    series = SurfaceSeries(surface_name, mesh.frame, vertices, mesh.triangles, STILL_TIMING, patient_id)
    return model_from_surfaces(series, options=options, progress=progress, sources=sources)


def model_from_labels(
    preop: Preop,
    *,
    options: ModelOptions = ModelOptions(),
    progress: Progress | None = None,
    sources: Sequence[str] = (),
) -> DvfModel:
    """Extract the organ's surface and the chambers of blood from 4-D labels and build the model.

    Raises:
        InvalidInputError: no label image, or no organ labels.
    """
    if preop.labels is None:
        raise InvalidInputError("the pre-operative data have no label image; build the model from surfaces")
    blood, names = preop.blood_labels, dict(preop.label_names)
    labels, organ, told_walls = labels_with_walls(
        preop.labels, preop.organ_labels, blood, [label_name(value, names) for value in blood]
    )
    for sentence in told_walls:
        log.warning("%s", sentence)
    reference = surfaces_from_labels(labels, organ, threads=options.threads)
    flags = [border_caps(mesh, preop.labels.grid) for mesh in reference]
    caps = caps_of(reference[0].vertices_mm, reference[0].triangles, flags[0])
    model = build_model(
        reference,
        flags,
        preop.labels.timing,
        patient_id=preop.patient_id,
        surface_name=preop.surface,
        frame=preop.labels.grid.frame,
        cavity_mm3=_labelled_mm3(preop.labels, preop.lv_label),
        options=options,
        progress=progress,
        sources=(*sources, *_marked(preop.surface, caps), *told_walls),
        chambers=chambers_from_labels(preop.labels, blood, names, threads=options.threads),
    )
    return replace(model, tissue=tissue_of_labels(preop, reference, model.ed_phase))


def _marked(name: str, caps: Sequence[Cap]) -> tuple[str, ...]:
    """Describe the caps of the first phase for the model's sources and log a warning; () without caps."""
    if not caps:
        return ()
    text = f"surface {name} is closed by {describe_caps(caps)}"
    log.warning("%s", text)
    return (text,)


def _labelled_mm3(labels: VolumeSeries, value: int | None) -> FloatArray | None:
    """Compute (n,) volumes of a label; None without one, or if a phase has no voxel of it."""
    if value is None:
        return None
    voxel_mm3 = float(np.prod(labels.grid.spacing_mm))
    volumes = np.array([np.count_nonzero(phase == value) * voxel_mm3 for phase in labels.values])
    return volumes if volumes.all() else None


def _check_reference(reference: Sequence[Mesh], timing: CycleTiming, frame: str, name: str) -> None:
    if len(reference) != len(timing):
        raise InvalidInputError(f"{len(reference)} surfaces for {len(timing)} phases; needed one a phase")
    if problem := heart_problem(np.concatenate([mesh.vertices_mm for mesh in reference])):
        raise InvalidInputError(f"surface {name} {problem}")
    checked: set[int] = set()
    for i, mesh in enumerate(reference):
        require_same_frame(frame, mesh.frame, f"surface {name}, phase {i}")
        if id(mesh.triangles) in checked:
            continue
        checked.add(id(mesh.triangles))
        census = count_edges(mesh.triangles)
        if not census.closed:
            raise InvalidInputError(
                f"surface {name}, phase {i} is not closed: {census}; "
                "close it first (model_from_surfaces does)"
            )


def border_distance_mm(model: DvfModel) -> float:
    """Compute the smallest distance from the surface, at any phase, to the border of the model's box."""
    return float(
        min(
            min((mesh.vertices_mm - model.origin_mm).min(), (model.upper_mm - mesh.vertices_mm).min())
            for mesh in model.reference
        )
    )


def potential_at_border(border_mm: float, gamma_per_mm: float) -> float:
    """Compute f of the sigmoid law `border_mm` outside the surface: the share of the cap left there."""
    return float(1.0 / (1.0 + np.exp(gamma_per_mm * border_mm)))
