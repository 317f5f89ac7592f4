"""Virtual fixtures as values, without a model: law, target and blend of each, and the cap of all together."""

import math
from dataclasses import dataclass, field

from dvf_ig.core import InvalidInputError

from .blend import BLEND_CODES, Blend
from .device import COMMON_DEVICE, DeviceLimits
from .laws import Confinement, Gaussian, Law, Sigmoid, require_force, require_reach
from .margins.margin import NO_MARGIN, MarginOptions
from .targets import PathTarget


@dataclass(frozen=True, slots=True)
class FixtureOptions:
    """One virtual fixture.

    Attributes:
        law: `Sigmoid` for a forbidden region, `Confinement` for a chamber, `Gaussian` for guidance.
        blend: how neighbouring phases of the model are blended; unused by a path.
        path: what a Gaussian guides to; None: the model's surface.
        name: of the fixture in messages.
    Raises:
        InvalidInputError: an unknown blend, or a forbidden region that is felt too far outside.
    """

    law: Law = field(default_factory=Sigmoid)
    blend: Blend = "force"
    path: PathTarget | None = None
    name: str = ""

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

    def described(self) -> dict[str, str | float | bool]:
        """Its law and numbers under the names of the command line's options; of a path not its points."""
        law = self.law
        numbers: dict[str, str | float | bool] = {"name": self.name, "cap_n": law.cap_n}
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
    Raises:
        InvalidInputError: no fixture, a cap that is not positive or beyond the device's continuous force, or
            a forbidden region that is felt too far outside.
    """

    fixtures: tuple[FixtureOptions, ...] = (FixtureOptions(),)
    cap_n: float | None = None
    margin: MarginOptions = NO_MARGIN
    device: DeviceLimits = COMMON_DEVICE

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

    @property
    def composed(self) -> bool:
        """Whether forces need composing: several fixtures, or a joint cap below that of the only one."""
        return len(self.fixtures) > 1 or self.joint_cap_n < self.fixtures[0].law.cap_n


FORBIDDEN_SURFACE = FixtureSet()
"""The model's surface as a forbidden region: assumed where no fixture is given."""
