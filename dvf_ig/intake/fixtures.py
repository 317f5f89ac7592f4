"""Read virtual fixtures from YAML, under the names of the command line's options.

cap_n: 0.6                  # of all together, N; default: the largest of them
retiming: two-segment       # or uniform
margin: adaptive            # or off, fixed (2 mm), or a number of mm
device: {name: omega.3, continuous_force_n: 12, stiffness_n_per_m: 2000}   # needed above 4 N or 400 N/m
tool: {diameter_mm: 5, shaft_mm: 60, fulcrum: {point_mm: [10, 20, 30], length_mm: 350}}
fixtures:                   # the first is the primary one
  - {law: forbidden, name: epicardium, gamma: 1.0, depth_mm: 2.0}
  - {law: path, delta: 4.0, path: incision.mrk.json}
  - {law: forbidden, name: oesophagus, model: oesophagus.npz}   # on a further structure
  - {law: path, path: line.mrk.json, model: left_atrium.npz}    # beats with its surface
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, field_validator

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.io.json_file import read_json
from dvf_ig.io.landmarks import CURVES, markup_points
from dvf_ig.io.limits import TIME_S
from dvf_ig.io.reading import reading
from dvf_ig.io.yaml_config import Section, read_yaml, validated

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.guidance import DeviceLimits, FixtureOptions, FixtureSet, PathTarget, Tool
    from dvf_ig.guidance.margins import MarginOptions

Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-TIME_S, le=TIME_S)]
"""Finite number; no length, time, force or stiffness from a user exceeds a time stamp."""
SMALLEST_MM = 0.05
"""Smallest depth or margin other than 0; one in m has 0.001 to 0.02."""


def _in_mm(value: float) -> float:
    if 0.0 < abs(value) < SMALLEST_MM:
        raise ValueError(f"{value:g} mm is no depth or margin of tissue; it may be in m: give mm")
    return value


Millimetres = Annotated[Number, AfterValidator(_in_mm)]
BlendName = Literal["force", "distance", "periodic"]
RetimingName = Literal["uniform", "two-segment"]
MARGINS = ("off", "fixed", "adaptive")


def _margin_choice(value: Any) -> Any:
    if value in MARGINS:
        return value
    if type(value) in (int, float) and math.isfinite(value):
        return _in_mm(value)
    raise ValueError(f"needed {', '.join(MARGINS)}, or a number of mm")


MarginChoice = Annotated[str | float, BeforeValidator(_margin_choice)]
"""Margin mode, or the width in mm of a fixed margin."""
Row = tuple[Number, Number, Number]


class _FixtureConfig(Section):
    """Keys of every fixture; `model` is the file of a further structure, None: the session's model."""

    name: str = ""
    cap_n: Number = 0.6
    model: Annotated[str, Field(min_length=1)] | None = None


class ForbiddenConfig(_FixtureConfig):
    """A forbidden region, or with `inside` a chamber that confines the tool (Ren 2008, eqs 4–6)."""

    law: Literal["forbidden"] = "forbidden"
    gamma: Number = 1.0
    depth_mm: Millimetres = 0.0
    inside: bool = False
    blend: BlendName = "force"

    def options(
        self, folder: Path | None = None, frame: str = "mr", structure: "DvfModel | None" = None
    ) -> "FixtureOptions":
        """Build the fixture; raise InvalidInputError for a number out of range."""
        from dvf_ig.guidance import Confinement, FixtureOptions, Sigmoid

        law = (Confinement if self.inside else Sigmoid)(self.gamma, self.cap_n, self.depth_mm)
        return FixtureOptions(law, self.blend, name=self.name, structure=structure)


class GuidanceConfig(_FixtureConfig):
    """Guidance to the model's surface or a depth below it (Ren 2008, eqs 7–9)."""

    law: Literal["guidance"] = "guidance"
    delta: Number = 3.0
    m: Number = 1.0
    depth_mm: Millimetres = 0.0
    blend: BlendName = "force"

    def options(
        self, folder: Path | None = None, frame: str = "mr", structure: "DvfModel | None" = None
    ) -> "FixtureOptions":
        """Build the fixture; raise InvalidInputError for a number out of range."""
        from dvf_ig.guidance import FixtureOptions, Gaussian

        law = Gaussian(self.delta, self.m, self.cap_n, self.depth_mm)
        return FixtureOptions(law, self.blend, name=self.name, structure=structure)


class PathConfig(_FixtureConfig):
    """Guidance to a path: straight segments between points, mm, LPS, in the session's model's frame.

    `path` is a list of points, or a curve of 3D Slicer, whose control points are used. With `model` it was
    drawn on that model's surface at end-diastole and beats with it; else it is at rest.
    """

    law: Literal["path"] = "path"
    delta: Number = 3.0
    m: Number = 1.0
    path: str | tuple[Row, ...]

    @field_validator("path", mode="before")
    @classmethod
    def _file_or_points(cls, value: Any) -> Any:
        rows = value if isinstance(value, list | tuple) else ()
        numbers = all(
            isinstance(row, list | tuple) and len(row) == 3 and all(type(c) in (int, float) for c in row)
            for row in rows
        )
        if isinstance(value, str) or (rows and numbers):
            return value
        raise ValueError("needed points [[x, y, z], …] in mm, or the name of a .mrk.json file")

    def options(
        self, folder: Path | None = None, frame: str = "mr", structure: "DvfModel | None" = None
    ) -> "FixtureOptions":
        """Build the fixture.

        Args:
            folder: base of relative file names; None: the working directory.
            frame: of the points.
            structure: model that `model` names.
        Raises:
            InvalidInputError: a number out of range, or an unfit path.
        """
        from dvf_ig.guidance import FixtureOptions, Gaussian, PathTarget

        target = self._target(folder or Path(), frame)
        if structure is not None:
            target = PathTarget.beating(structure, target.points_mm[0])
        law = Gaussian(self.delta, self.m, self.cap_n)
        return FixtureOptions(law, path=target, name=self.name, structure=structure)

    def _target(self, folder: Path, frame: str) -> "PathTarget":
        from dvf_ig.guidance import PathTarget

        if not isinstance(self.path, str):
            return PathTarget.static(frame, self.path)
        file = folder / self.path
        with reading(file, "a curve"):
            points = markup_points(file, CURVES)[1]
            markups = read_json(file)["markups"]
            if len(markups) != 1:
                raise UnreadableFileError(f"{file} holds {len(markups)} markups; needed one, the curve")
            if markups[0].get("type") == "ClosedCurve":
                points = np.concatenate([points, points[:1]])
            return PathTarget.static(frame, points)


FixtureConfig = Annotated[ForbiddenConfig | GuidanceConfig | PathConfig, Field(discriminator="law")]
LAWS: dict[str, type[ForbiddenConfig | GuidanceConfig | PathConfig]] = {
    "forbidden": ForbiddenConfig,
    "guidance": GuidanceConfig,
    "path": PathConfig,
}


class DeviceConfig(Section):
    """The haptic device that renders the fixtures, for forces above 4 N or stiffness other than 400 N/m."""

    name: Annotated[str, Field(strict=True, min_length=1)]
    continuous_force_n: Number
    stiffness_n_per_m: Number = 400.0

    @classmethod
    def of(cls, device: "DeviceLimits") -> "DeviceConfig | None":
        """The section that states a device; None for one without a name."""
        if not device.name:
            return None
        return cls(
            name=device.name,
            continuous_force_n=device.continuous_force_n,
            stiffness_n_per_m=device.stiffness_n_per_m,
        )

    def limits(self) -> "DeviceLimits":
        """Build the device limits; raise InvalidInputError for a number out of range."""
        from dvf_ig.guidance import DeviceLimits

        return DeviceLimits(
            stiffness_n_per_m=self.stiffness_n_per_m,
            continuous_force_n=self.continuous_force_n,
            name=self.name,
        )


class FulcrumConfig(Section):
    """Trocar through which the tool passes, in the tracker's frame, and the length from hand to tip."""

    point_mm: Row
    length_mm: Number


class ToolShapeConfig(Section):
    """Thickness, shaft and fulcrum of the tool; nothing stated is a point.

    `axis` leads from the tip to the handle in the tool's own frame; a fulcrum gives the direction as well.
    """

    diameter_mm: Number = 0.0
    shaft_mm: Number = 0.0
    axis: Row | None = None
    fulcrum: FulcrumConfig | None = None

    @classmethod
    def of(cls, tool: "Tool") -> "ToolShapeConfig | None":
        """The section that states a tool; None for a point."""
        fulcrum = tool.fulcrum
        stated = {
            "diameter_mm": tool.diameter_mm,
            "shaft_mm": tool.shaft_mm,
            "axis": None if tool.axis is None else tool.axis.tolist(),
            "fulcrum": None
            if fulcrum is None
            else {"point_mm": fulcrum.point_mm.tolist(), "length_mm": fulcrum.length_mm},
        }
        return cls.model_validate(stated) if any(stated.values()) else None

    def shape(self) -> "Tool":
        """Build the tool; raise InvalidInputError for a number out of range."""
        from dvf_ig.guidance import Fulcrum, Tool

        fulcrum = None
        if self.fulcrum is not None:
            fulcrum = Fulcrum(np.array(self.fulcrum.point_mm), self.fulcrum.length_mm)
        axis = None if self.axis is None else np.array(self.axis)
        return Tool(self.diameter_mm, self.shaft_mm, axis, fulcrum)

    @property
    def stated(self) -> bool:
        """Whether it states anything but a point."""
        return any((self.diameter_mm, self.shaft_mm, self.axis, self.fulcrum))


class FixturesConfig(Section):
    """The fixtures of an intervention, their joint cap, margin, device and tool, and the law of retiming."""

    fixtures: tuple[FixtureConfig, ...] = (ForbiddenConfig(),)
    cap_n: Number | None = None
    retiming: RetimingName | None = None
    margin: MarginChoice = "off"
    device: DeviceConfig | None = None
    tool: ToolShapeConfig | None = None

    @classmethod
    def of(cls, fixtures: "FixtureSet") -> "FixturesConfig":
        """Describe fixtures whose structures are in the files of `structure_files`.

        Raises:
            pydantic.ValidationError: a path that moves with no structure, which no configuration can state.
        """
        described: list[dict[str, Any]] = []
        names = {id(model): name for name, model in structure_files(fixtures).items()}
        for one in fixtures.fixtures:
            stated: dict[str, Any] = one.described()
            if one.structure is not None:
                del stated["structure"]
                stated["model"] = names[id(one.structure)]
            if one.path is not None:
                beats = one.structure is not None and one.path.timing is not None
                drawn = one.structure.ed_phase if one.structure and beats else slice(None)
                stated["path"] = one.path.points_mm[drawn].reshape(-1, 3).tolist()
            described.append(stated)
        margin = fixtures.margin
        return cls.model_validate(
            {
                "fixtures": described,
                "cap_n": fixtures.cap_n,
                "device": DeviceConfig.of(fixtures.device),
                "tool": ToolShapeConfig.of(fixtures.tool),
                "margin": margin.fixed_mm if margin.mode == "fixed" else margin.mode,
            }
        )

    def fixture_set(self, folder: Path, frame: str = "mr") -> "FixtureSet":
        """Build the fixtures.

        Args:
            folder: base of relative file names.
            frame: of the model and of every path.
        Raises:
            InvalidInputError: a number out of range, an unfit path or an unreadable model; names the key.
        """
        from dvf_ig.guidance import FixtureSet
        from dvf_ig.guidance.device import COMMON_DEVICE
        from dvf_ig.guidance.tool import POINT
        from dvf_ig.io.model.model_file import read_model

        options = []
        structures: dict[str | None, DvfModel | None] = {None: None}
        for n, one in enumerate(self.fixtures):
            try:
                if one.model not in structures:
                    structures[one.model] = read_model(folder / str(one.model))
                options.append(one.options(folder, frame, structures[one.model]))
            except InvalidInputError as exc:
                raise InvalidInputError(f"fixtures.{n}: {exc}") from exc
        device = COMMON_DEVICE if self.device is None else self.device.limits()
        tool = POINT if self.tool is None else self.tool.shape()
        return FixtureSet(tuple(options), self.cap_n, margin_options(self.margin), device, tool)


STRUCTURES = "structure-"
"""Begin of the names of files that hold further structures."""


def structure_files(fixtures: "FixtureSet") -> dict[str, "DvfModel"]:
    """The models of further structures, each once, by the name of the file that holds it."""
    models = {id(one.structure): one.structure for one in fixtures.fixtures if one.structure is not None}
    return {f"{STRUCTURES}{k}.npz": model for k, model in enumerate(models.values())}


def margin_options(choice: str | float) -> "MarginOptions":
    """Build margin options from a mode or a width in mm.

    Raises:
        InvalidInputError: another mode, or a width out of range.
    """
    from dvf_ig.guidance.margins import MarginOptions

    if isinstance(choice, str):
        return MarginOptions(choice)  # type: ignore[arg-type]
    return MarginOptions("fixed", fixed_mm=float(choice))


def fixture_options(values: Mapping[str, Any]) -> "FixtureOptions":
    """Build one fixture from its law and some of that law's keys (`LAWS`).

    Raises:
        InvalidInputError: a number out of range.
    """
    config: ForbiddenConfig | GuidanceConfig | PathConfig = TypeAdapter(FixtureConfig).validate_python(
        dict(values)
    )
    return config.options()


def read_fixtures(path: Path | str, frame: str = "mr") -> tuple["FixtureSet", RetimingName | None]:
    """Read fixtures from a YAML file, with the retiming law if the file states one.

    Args:
        path: the file; names of other files in it are relative to its folder.
        frame: of the model and of every path.
    Raises:
        UnreadableFileError: absent, not YAML, unknown keys, or values that do not fit; names file and key.
    """
    path = Path(path)
    config = validated(FixturesConfig, read_yaml(path, "a description of fixtures"), path)
    with reading(path, "a description of fixtures"):
        return config.fixture_set(path.parent, frame), config.retiming
