"""The dynamic virtual fixture model: one spline of signed distance a phase, and chambers of blood."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import BoolArray, FloatArray, frozen, frozen_floats, read_only_arrays
from .errors import InvalidInputError
from .seen_part import SeenPart
from .space.frames import check_frame, require_same_frame
from .space.mesh import Mesh
from .timing.cycle import CycleTiming, phase_at_rest
from .tissue import Tissue


@dataclass(frozen=True, slots=True, eq=False)
class Chamber:
    """Closed surface of a blood-filled space, which ultrasound shows, over the cycle.

    Attributes:
        name: for example "LV_ENDOCARDIAL" or "lv_blood".
        surfaces: one mesh a phase, outward orientation; vertices and triangles may differ between phases.
            Vertices are rounded to 32-bit floats (1e-5 mm), as the model's file holds them.
    """

    name: str
    surfaces: tuple[Mesh, ...]

    def __post_init__(self) -> None:
        rounded = tuple(
            Mesh(mesh.frame, mesh.vertices_mm.astype(np.float32), mesh.triangles) for mesh in self.surfaces
        )
        object.__setattr__(self, "surfaces", rounded)

    def phase(self, i: int) -> Mesh:
        return self.surfaces[i]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DvfModel:
    """Signed distance d(q, phase i) = Σ p_ijk B(x) B(y) B(z), cubic (Ren 2008, eq. 1); d > 0 inside.

    Attributes:
        patient_id: identifier of the patient.
        surface_name: name of the surface, for example "EPICARDIAL".
        frame: frame of every coordinate here, normally "mr".
        timing: phase times and the RR interval they were acquired at.
        es_fraction: end-systole (smallest volume) as a fraction of the cycle.
        ed_phase: index of end-diastole (largest enclosed volume).
        coefficients: (n, cx, cy, cz) float32 spline coefficients in mm.
        origin_mm: (3,) where u = 0; with u = (q − origin)/knot_spacing and i = floor(u), the value at q uses
            coefficients i … i+3, so the model is defined for 0 <= u <= c − 3 along each axis.
        knot_spacing_mm: knot pitch, the same along each axis.
        reference: one mesh a phase, the surface the model was fitted to.
        reference_caps: per phase, True for triangles that close an opening and were never measured.
        sources: data it was built from, for the record.
        cine_fingerprint: of the grey levels it was built from (`VolumeSeries.fingerprint`); None without any.
        chambers: the blood within the organ, which ultrasound shows; none if it is not known.
        seen: the part of the surface that a stack of slices shows; None if all of it is known.
        tissue: labels of end-diastole and the motion that carries them; None if either is not known.
    """

    patient_id: str
    surface_name: str
    frame: str
    timing: CycleTiming
    es_fraction: float
    ed_phase: int
    coefficients: NDArray[np.float32]
    origin_mm: FloatArray
    knot_spacing_mm: float
    reference: tuple[Mesh, ...]
    reference_caps: tuple[BoolArray, ...]
    sources: tuple[str, ...] = ()
    chambers: tuple[Chamber, ...] = ()
    cine_fingerprint: str | None = None
    seen: SeenPart | None = None
    tissue: Tissue | None = None

    def __post_init__(self) -> None:
        check_frame(self.frame)
        n = len(self.timing)
        coefficients = np.ascontiguousarray(self.coefficients, dtype=np.float32)
        if coefficients.ndim != 4 or len(coefficients) != n or min(coefficients.shape[1:]) < 4:
            raise InvalidInputError(
                f"spline coefficients have shape {coefficients.shape}; needed ({n}, >=4, >=4, >=4)"
            )
        if not np.isfinite(coefficients).all():
            raise InvalidInputError("spline coefficients are not all finite; build the model again")
        if len(self.reference) != n or len(self.reference_caps) != n:
            raise InvalidInputError(
                f"{len(self.reference)} reference surfaces and {len(self.reference_caps)} cap lists "
                f"for {n} phases"
            )
        if self.knot_spacing_mm <= 0:
            raise InvalidInputError(f"knot spacing is {self.knot_spacing_mm:g} mm; it must be positive")
        for chamber in self.chambers:
            if len(chamber.surfaces) != n:
                raise InvalidInputError(
                    f"chamber {chamber.name} has {len(chamber.surfaces)} surfaces for {n} phases"
                )
            for mesh in chamber.surfaces:
                require_same_frame(self.frame, mesh.frame, f"chamber {chamber.name}")
        if self.seen is not None and len(self.seen.bounds_mm) != n:
            raise InvalidInputError(f"seen slabs of {len(self.seen.bounds_mm)} phases for {n} phases")
        if self.tissue is not None:
            require_same_frame(self.frame, self.tissue.labels.grid.frame, "tissue of the model")
            if len(self.tissue.motion) != n:
                raise InvalidInputError(f"motion of {len(self.tissue.motion)} phases for {n} phases")
        coefficients.setflags(write=False)
        object.__setattr__(self, "coefficients", coefficients)
        object.__setattr__(self, "origin_mm", frozen_floats(self.origin_mm, "model origin", (3,)))
        caps = tuple(
            frozen(c, "cap flags", (len(m.triangles),), np.bool_)
            for c, m in zip(self.reference_caps, self.reference, strict=True)
        )
        object.__setattr__(self, "reference_caps", caps)

    def require_patient(self, patient_id: str, this_is: str = "the model is") -> None:
        """Raise InvalidInputError, with advice, unless this is the model of that patient."""
        if self.patient_id != patient_id:
            raise InvalidInputError(
                f"{this_is} of patient '{self.patient_id}', needed patient '{patient_id}'; choose the right "
                "patient's model, or, if it is the same patient, give the other data the same name: "
                f"--patient '{self.patient_id}', or patient_id: '{self.patient_id}' in their YAML file"
            )

    def unseen(self, phase: int) -> BoolArray:
        """(t,) triangles of a phase's surface that no slice shows."""
        mesh = self.reference[phase]
        if self.seen is None:
            return np.zeros(len(mesh.triangles), dtype=np.bool_)
        return ~self.seen.holds(mesh.vertices_mm[mesh.triangles].mean(axis=1), phase)

    @property
    def unseen_share(self) -> float:
        """Share of the area of the end-diastolic surface that no slice shows."""
        mesh = self.reference[self.ed_phase]
        a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return float(area[self.unseen(self.ed_phase)].sum() / area.sum())

    @property
    def phases(self) -> int:
        return len(self.timing)

    @property
    def rest_phase(self) -> int:
        """Index of the phase nearest to the R peak, from which the heart contracts."""
        return phase_at_rest(self.timing.fractions)

    @property
    def still(self) -> bool:
        """Whether the surface is the same in every phase, as that of a structure that does not beat."""
        return all(np.array_equal(one, self.coefficients[0]) for one in self.coefficients[1:])

    @property
    def upper_mm(self) -> FloatArray:
        """Far corner (3,) of the box in which the model is defined."""
        knots = np.array(self.coefficients.shape[1:]) - 3
        return np.asarray(self.origin_mm + knots * self.knot_spacing_mm)

    @property
    def megabytes(self) -> float:
        return self.coefficients.nbytes / 1e6
