"""Device names of what a session takes, and the poses and images that messages hold under them."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError

from .igtl import Image, Message, TrackingData, Transform, WireError, WireProblem

_LONG_NAME = "IGTL_DEVICE_NAME"
"""Field in which PLUS gives a name that is longer than a device name can be."""
_STATUS = "TransformStatus"
_NAME_CHARACTERS = 20
SMALLEST_IMAGE = 16
"""Rows and columns of an image that shows anything; scanners send hundreds."""


class Role(Enum):
    """Role of a device whose pose is sent."""

    PROBE = "probe"
    TOOL = "tool"
    REFERENCE = "reference"
    CHEST = "chest"


class Posed(NamedTuple):
    """One pose that came: (4, 4) in mm, NaN if not finite, None if not tracked."""

    role: Role
    matrix: FloatArray | None


@dataclass(frozen=True, slots=True)
class DeviceNames:
    """Names as the peer sends them; longer ones are compared by what a device name can hold.

    Attributes:
        reference: None if poses are relative to the tracker.
        chest: marker that follows the breath; None if there is none.
        flips: axes of the image (0 rows, 1 columns) to be turned about to what the probe was calibrated with.
    """

    probe: str
    tool: str
    image: str
    reference: str | None = None
    chest: str | None = None
    flips: tuple[int, ...] = ()

    def poses(self, message: Message) -> Iterator[Posed]:
        """The poses in a message that are of use."""
        content = message.content
        if isinstance(content, Transform):
            role = self._role(message.fields.get(_LONG_NAME, message.device))
            if role is not None:
                tracked = message.fields.get(_STATUS, "OK") == "OK"
                yield Posed(role, content.matrix if tracked else None)
        elif isinstance(content, TrackingData):
            for tool in content.tools:
                role = self._role(tool.name)
                if role is not None:
                    tracked = message.fields.get(f"{tool.name}Status", "OK") == "OK"
                    yield Posed(role, tool.matrix if tracked else None)

    def refused_pose(self, error: WireError) -> Posed | None:
        """Pose stated by a refused message: not finite, or not rigid and so not tracked."""
        role = self._role(error.device)
        if role is None or error.problem not in (WireProblem.NOT_FINITE, WireProblem.NOT_RIGID):
            return None
        return Posed(role, np.full((4, 4), np.nan) if error.problem is WireProblem.NOT_FINITE else None)

    def image_of(self, message: Message) -> NDArray[np.uint8] | None:
        """The message's B-mode image, turned as the probe was calibrated; None if it is another image.

        Raises:
            InvalidInputError: it is not one slice of grey bytes, or smaller than SMALLEST_IMAGE.
        """
        if not isinstance(message.content, Image) or message.device != self.image[:_NAME_CHARACTERS]:
            return None
        pixels = message.content.pixels
        if pixels.ndim != 3 or len(pixels) != 1 or pixels.dtype != np.uint8:
            raise InvalidInputError(
                f"image '{message.device}' has shape {pixels.shape} and type {pixels.dtype}; needed one "
                "slice of uint8: let PLUS send brightness images (US_IMG_BRIGHTNESS)"
            )
        if min(pixels.shape[1:]) < SMALLEST_IMAGE:
            raise InvalidInputError(
                f"image '{message.device}' has {pixels.shape[1]} x {pixels.shape[2]} pixels; needed "
                f"{SMALLEST_IMAGE} x {SMALLEST_IMAGE} or more: check what PLUS sends"
            )
        return np.ascontiguousarray(np.flip(pixels[0], self.flips))

    def _role(self, name: str) -> Role | None:
        owners = (self.probe, self.tool, self.reference, self.chest)
        for role, own in zip(Role, owners, strict=True):
            if own is not None and name[:_NAME_CHARACTERS] == own[:_NAME_CHARACTERS]:
                return role
        return None


def flips_between(sent: str, calibrated: str) -> tuple[int, ...]:
    """Axes to be turned about from one PLUS orientation to another.

    Args:
        sent, calibrated: columns towards the marked (M) or unmarked (U) side, rows far (F) or near (N).
    """
    return tuple(axis for axis, letter in ((0, 1), (1, 0)) if sent[letter] != calibrated[letter])
