"""Virtual fixtures: their options as values, and fixtures bound to a patient's model as one force."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, IntArray, InvalidInputError, Rigid, require_same_frame

from .blend import BLEND_CODES, Blend, static_force
from .composition import Composed, Contribution, compose
from .device import COMMON_DEVICE, MM_PER_M, DeviceLimits
from .evaluator import Evaluator, ForceSamples
from .laws import Confinement, Gaussian, Law, Sigmoid, require_force, require_reach
from .margins import NO_MARGIN, MarginOptions
from .places import Status
from .targets import PathFixture, PathTarget
from .tool import POINT, Tool


@dataclass(frozen=True, slots=True)
class FixtureOptions:
    """One virtual fixture.

    Attributes:
        law: `Sigmoid` for a forbidden region, `Confinement` for a chamber, `Gaussian` for guidance.
        blend: how neighbouring phases of the model are blended; unused by a path.
        path: what a Gaussian guides to; None: the model's surface.
        name: of the fixture in messages.
        structure: model of a further structure on whose surface the fixture is, or with which its path beats;
            None: the session's model, or a path in its frame.
    Raises:
        InvalidInputError: an unknown blend, or a forbidden region that is felt too far outside.
    """

    law: Law = field(default_factory=Sigmoid)
    blend: Blend = "force"
    path: PathTarget | None = None
    name: str = ""
    structure: DvfModel | None = None

    def __post_init__(self) -> None:
        if self.blend not in BLEND_CODES:
            raise InvalidInputError(f"unknown blend '{self.blend}'; choose one of {', '.join(BLEND_CODES)}")
        require_reach(self.law)

    def named(self, problem: InvalidInputError) -> InvalidInputError:
        """The problem with the name of this fixture, if it has one."""
        return type(problem)(f"fixture '{self.name}': {problem}") if self.name else problem

    @property
    def forbidden(self) -> bool:
        """Whether it comes before guidance in a composition."""
        return not isinstance(self.law, Gaussian)

    @property
    def on_model(self) -> bool:
        """Whether it is on the surface of the session's model: no path, and on no further structure."""
        return self.path is None and self.structure is None

    def described(self) -> dict[str, str | float | bool]:
        """Its law and numbers under the names of the command line's options; of a path not its points."""
        law = self.law
        numbers: dict[str, str | float | bool] = {"name": self.name, "cap_n": law.cap_n}
        if self.structure is not None:
            numbers["structure"] = self.structure.surface_name
        if isinstance(law, Gaussian):
            numbers |= {"delta": law.delta_mm, "m": law.m}
            if self.path is not None:
                return {"law": "path", **numbers}
        else:
            numbers |= {"gamma": law.gamma_per_mm, "inside": isinstance(law, Confinement)}
        name = "forbidden" if self.forbidden else "guidance"
        return {"law": name, **numbers, "depth_mm": law.depth_mm, "blend": self.blend}


@dataclass(frozen=True, slots=True)
class FixtureSet:
    """The fixtures that act on one tool together; the first is the primary one.

    Attributes:
        fixtures: one or several; unless given, the forbidden region of Ren 2008.
        cap_n: largest force of all together, N; None: the largest cap among them.
        margin: by which a session widens them; a path keeps its law.
        device: what renders them.
        tool: what they act on.
    Raises:
        InvalidInputError: no fixture, a cap that is not positive or beyond the device's continuous force, or
            a forbidden region that is felt too far outside.
    """

    fixtures: tuple[FixtureOptions, ...] = (FixtureOptions(),)
    cap_n: float | None = None
    margin: MarginOptions = NO_MARGIN
    device: DeviceLimits = COMMON_DEVICE
    tool: Tool = POINT

    def __post_init__(self) -> None:
        if not self.fixtures:
            raise InvalidInputError("a fixture set holds no fixture; needed at least one")
        if self.cap_n is not None:
            require_force("the joint cap", self.cap_n)
            self.device.require_force("the joint cap", self.cap_n)
        for one in self.fixtures:
            try:
                self.device.require_force("force cap cap_n", one.law.cap_n)
                require_reach(one.law, self.margin.wanted_mm(math.nan))
            except InvalidInputError as exc:
                raise one.named(exc) from exc

    @property
    def joint_cap_n(self) -> float:
        """Largest force of all together, N."""
        return max(f.law.cap_n for f in self.fixtures) if self.cap_n is None else self.cap_n

    def law(self, one: FixtureOptions) -> Law:
        """The law of a fixture for the centre of the tip: surfaces act on the tool's surface."""
        if one.path is not None:
            return one.law
        return dataclasses.replace(one.law, depth_mm=one.law.depth_mm - self.tool.radius_mm)

    @property
    def on_model_alone(self) -> bool:
        """Whether every fixture is on the session's model: then a distance to it gives all forces."""
        return all(one.on_model for one in self.fixtures)

    @property
    def composed(self) -> bool:
        """Whether forces need composing: several fixtures, or a joint cap below that of the only one."""
        return len(self.fixtures) > 1 or self.joint_cap_n < self.fixtures[0].law.cap_n


FORBIDDEN_SURFACE = FixtureSet()
"""The model's surface as a forbidden region: assumed where no fixture is given."""


REACH_WIDTHS = 4.0
SAMPLES = 401
"""The joint force is sampled so far about each law's depth, in widths δ or 1/γ, and at so many distances."""


def composed_force(options: FixtureSet, forces_n: FloatArray) -> Composed:
    """All forces (k, 3) in one, k fixtures in the order of the set."""
    forbidden: list[Contribution] = []
    guidance: list[Contribution] = []
    for one, force_n in zip(options.fixtures, forces_n, strict=True):
        part = Contribution("query", force_n, one.law.cap_n)
        (forbidden if one.forbidden else guidance).append(part)
    return compose(forbidden, guidance, frame="query", cap_n=options.joint_cap_n)


def force_at_distance(options: FixtureSet, distance_mm: FloatArray, normal: FloatArray) -> FloatArray | None:
    """(n, 3) force where distance and direction are known otherwise, for example from ground truth.

    Args:
        distance_mm: (n,) signed distance to the organ's surface.
        normal: (n, 3) its unit gradient.
    Returns:
        the force in the frame of `normal`; None for a set with a path or a structure, whose distance this is
        not, or a shaft.
    """
    if not options.on_model_alone or options.tool.shaft_mm > 0.0:
        return None
    each = np.stack([static_force(options.law(one), distance_mm, normal) for one in options.fixtures], axis=1)
    if not options.composed:
        return np.asarray(each[:, 0])
    return np.array([composed_force(options, forces).force_n for forces in each]).reshape(-1, 3)


def check_joint_stiffness(options: FixtureSet) -> None:
    """Hold the fixtures on surfaces, composed, to their device's stiffness along the normal.

    Fixtures on one surface count at their distances; different surfaces may touch, so their slopes add up.

    Raises:
        InvalidInputError: together they are stiffer than the device renders.
    """
    on_surfaces = [one for one in options.fixtures if one.path is None]
    if len(on_surfaces) < 2:
        return
    structures = dict.fromkeys(one.structure for one in on_surfaces)
    steepest = [
        _steepest(options, tuple(one for one in on_surfaces if one.structure is structure))
        for structure in structures
    ]
    slope, allowed = sum(one[0] for one in steepest), options.device.allowed_stiffness_n_per_mm
    if slope > allowed * (1.0 + 1e-6):
        where = f"{steepest[0][1]:.2g} mm below the surface"
        where = where if len(structures) == 1 else "where their surfaces touch"
        raise InvalidInputError(
            f"the fixtures together are too stiff for the device: {slope * MM_PER_M:.4g} N/m {where}, "
            f"at most {allowed * MM_PER_M:.4g} N/m allowed; lower a cap, make a law less steep, or set their "
            "depths apart"
        )


def _steepest(options: FixtureSet, fixtures: tuple[FixtureOptions, ...]) -> tuple[float, float]:
    """Largest slope, N/mm, of the composed force of fixtures on one surface, and its depth in mm.

    Secants of the force over distance: they never exceed the steepest slope, and miss little of it.
    """
    on_surface = tuple(dataclasses.replace(one, structure=None) for one in fixtures)
    # whole µm: over less, rounding of the force would count as slope
    distance_mm = np.unique(np.concatenate([_about_depth(one.law) for one in on_surface]).round(3))
    normal = np.tile([1.0, 0.0, 0.0], (len(distance_mm), 1))
    force_n = force_at_distance(dataclasses.replace(options, fixtures=on_surface), distance_mm, normal)
    if force_n is None:
        return 0.0, 0.0
    slope = np.abs(np.diff(force_n[:, 0])) / np.diff(distance_mm)
    steepest = int(slope.argmax())
    return float(slope[steepest]), float(distance_mm[steepest])


def _about_depth(law: Law) -> FloatArray:
    """(SAMPLES,) distances about the depth that a law guards."""
    width_mm = law.delta_mm if isinstance(law, Gaussian) else 1.0 / law.gamma_per_mm
    # a confinement's depth is in the wall, outside the surface
    depth_mm = float(law.parameters[4])
    half_mm = REACH_WIDTHS * width_mm
    return np.linspace(depth_mm - half_mm, depth_mm + half_mm, SAMPLES)


class Fixtures:
    """One or several fixtures, ready to evaluate their force together.

    A single fixture goes straight to its kernel; several are composed (`compose`: forbidden regions before
    guidance, one joint cap). Where any fixture has a status other than OK there is no force of any of them,
    and the first such status is that of all. Distance, gradient and rate are those of the primary fixture.

    A forbidden region on a further structure has no force outside that structure's box, which contains its
    whole reach, and takes no force from the others there: the primary fixture is then the first
    one within reach, and distance and gradient are NaN if there is none.

    Where no slice shows the surface there is no force (status UNSEEN); with an adaptive margin there is one,
    and the session makes the margin the largest there.

    At NO_PHASE only forbidden regions act, each at its worst phase (`dvf_ig.kernels.worst_phase`), and
    distance and gradient are those of the first of them.

    Args:
        model: this patient's model; every fixture that names no structure is on its surface.
        options: the fixtures, their joint cap, and the device that renders them.
    Raises:
        InvalidInputError: laws beyond the device's limits, each alone or those on the surface together, or a
            path with an unfit law; a structure of another patient or with other phase times than the model
            (unless it does not beat), or a wall that is felt outside its structure's box.
        FrameMismatchError: a path or a structure in another frame than the model.
    """

    def __init__(self, model: DvfModel, options: FixtureSet = FORBIDDEN_SURFACE) -> None:
        self.model = model
        self.options = options
        self.parts = tuple(_bound(model, one, options) for one in options.fixtures)
        check_joint_stiffness(options)
        self._composed = options.composed
        self._forbidden = np.array([one.forbidden for one in options.fixtures])
        self.far_outside = tuple(
            one.structure is not None and isinstance(one.law, Sigmoid) for one in options.fixtures
        )
        """(k,) whether each fixture is merely far away outside its structure's box."""

    @property
    def walls(self) -> bool:
        """Whether a forbidden region is among them: then a force remains where the phase is not known."""
        return bool(self._forbidden.any())

    def evaluate(
        self, model_from_query: Rigid, xyz_mm: Any, model_phase: Any, status: IntArray | None = None
    ) -> ForceSamples:
        """Forces at n points, in the query frame.

        Args:
            model_from_query: rigid map of the query frame into the model's.
            xyz_mm: (n, 3) points in the query frame.
            model_phase: (n,) phase of the model's cycle, taken modulo 1; or one number for all points.
            status: (n,) `Status` of the input; entries that are not OK get no force, but those of walls at
                NO_PHASE. None: all OK.
        Raises:
            FrameMismatchError: the model is in another frame than the map's target.
            InvalidInputError: shapes that do not fit.
        """
        each = [part.force_through(model_from_query, xyz_mm, model_phase, status) for part in self.parts]
        each = [
            unfelt_outside(one, status) if far_outside else one
            for one, far_outside in zip(each, self.far_outside, strict=True)
        ]
        if not self._composed:
            return each[0]
        codes, count = np.array([one.status for one in each]), len(each[0])
        refused = (codes != Status.OK) & (codes != Status.NO_PHASE)
        reasons = codes[np.argmax(refused, axis=0), np.arange(count)]
        served = ~refused.any(axis=0) & ((reasons == Status.OK) | self.walls)
        near = np.isfinite([one.distance_mm for one in each])
        eligible = near & (self._forbidden[:, None] | (reasons != Status.NO_PHASE))
        first: IntArray = np.asarray(eligible.argmax(axis=0))

        def primary(name: str) -> FloatArray:
            values = np.array([getattr(one, name) for one in each])[first, np.arange(count)]
            values[~served] = np.nan
            return values

        force, conflict = np.zeros((count, 3)), np.zeros(count, dtype=np.bool_)
        for i in np.flatnonzero(served).tolist():
            together = composed_force(self.options, np.array([one.force_n[i] for one in each]))
            force[i], conflict[i] = together.force_n, together.conflict
        return ForceSamples(
            model_from_query.source,
            force,
            primary("distance_mm"),
            primary("gradient"),
            reasons,
            primary("rate_mm_per_cycle"),
            conflict=conflict,
        )


def unfelt_outside(samples: ForceSamples, input_status: IntArray | None) -> ForceSamples:
    """Turn OUT_OF_VOLUME of a wall, whose structure is merely far away, into the status of the input."""
    far = samples.status == Status.OUT_OF_VOLUME
    status = np.int64(Status.OK) if input_status is None else np.asarray(input_status)
    return dataclasses.replace(samples, status=np.where(far, status, samples.status))


def _bound(model: DvfModel, one: FixtureOptions, options: FixtureSet) -> Evaluator | PathFixture:
    device, withhold = options.device, options.margin.mode != "adaptive"
    try:
        surface = model
        if one.structure is not None:
            surface = one.structure
            room_mm = options.margin.wanted_mm(math.nan) + options.tool.radius_mm
            _require_fit(surface, model, one, room_mm)
        if one.path is None:
            return Evaluator(
                surface, options.law(one), blend=one.blend, device=device, withhold_unseen=withhold
            )
        require_same_frame(model.frame, one.path.frame, "path of a fixture")
        return PathFixture(one.path, one.law, device=device)
    except InvalidInputError as exc:
        raise one.named(exc) from exc


def _require_fit(structure: DvfModel, model: DvfModel, one: FixtureOptions, margin_mm: float) -> None:
    """Refuse a structure that does not belong to the model, or whose box ends where a wall is still felt."""
    name = structure.surface_name
    require_same_frame(model.frame, structure.frame, f"structure {name}")
    structure.require_patient(model.patient_id, f"the structure {name} is")
    same = np.array_equal(structure.timing.fractions, model.timing.fractions)
    if not structure.still and not (same and structure.timing.rr_s == model.timing.rr_s):
        raise InvalidInputError(
            f"the structure {name} has other phase times than the session's model; needed both from the same "
            "images, or one that does not beat"
        )
    if one.path is not None or not isinstance(one.law, Sigmoid):
        return
    vertices_mm = np.concatenate([mesh.vertices_mm for mesh in structure.reference])
    below_mm = (vertices_mm.min(axis=0) - structure.origin_mm).min()
    above_mm = (structure.upper_mm - vertices_mm.max(axis=0)).min()
    room_mm = min(float(below_mm), float(above_mm))
    reach_mm = one.law.reach_mm + margin_mm
    if room_mm < reach_mm:
        raise InvalidInputError(
            f"the model of the structure {name} ends {room_mm:.1f} mm from its surface, but the wall is felt "
            f"{reach_mm:.1f} mm from it, margin included; build it with --margin-mm {math.ceil(reach_mm)} or "
            "more, or make the law steeper"
        )
