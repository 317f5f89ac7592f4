"""Read named landmarks of a calibration phantom from a PLUS device set."""

from pathlib import Path

import numpy as np

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import phantom_problem
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.io.reading import reading

from .xml import numbers, parse_xml


def read_phantom_landmarks(device_set_xml: Path | str) -> Landmarks:
    """Read the `<Landmarks>` of a `<PhantomDefinition>`, mm, frame "phantom", in the file's order.

    Raises:
        UnreadableFileError: absent, not XML, or no landmarks.
    """
    path = Path(device_set_xml)
    with reading(path, "a PLUS device set"):
        elements = [
            element
            for section in parse_xml(path, "a PLUS device set").iter("Landmarks")
            for element in section.iter("Landmark")
        ]
        if not elements:
            raise UnreadableFileError(f"{path} defines no <Landmark>; give the device set with the phantom")
        positions = np.array([numbers(path, element, "Position", 3) for element in elements])
        if problem := phantom_problem(positions):
            raise InvalidInputError(f"its phantom {problem}")
        names = tuple(element.attrib.get("Name", f"#{i + 1}") for i, element in enumerate(elements))
        return Landmarks(names, Points("phantom", positions))
