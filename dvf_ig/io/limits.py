"""Limits of what a file may hold: beyond them it is damaged, hostile, or not about a heart.

They are checked before memory is reserved.
"""

from typing import Any

import numpy as np

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.plausible import ECG_VALUE as ECG_VALUE
from dvf_ig.core.plausible import LENGTH_MM as LENGTH_MM
from dvf_ig.core.plausible import TIME_S as TIME_S
from dvf_ig.core.plausible import VOXEL_MM as VOXEL_MM

FILE_BYTES = 8 << 30
"""Largest file read as a whole: ten minutes of uncompressed ultrasound at 30 frames/s (820 x 616) have 9 GB,
and parsing half of that needs two copies in a workstation's memory."""
TEXT_BYTES = 256 << 20
"""Largest table, mesh or XML as text: two leads for three hours at 1 kHz."""
HEADER_BYTES = 128 << 20
"""Largest header of a sequence: 100 000 frames (an hour at 28/s) with two tools have 60 MB."""
SETTINGS_BYTES = 4 << 20
"""Largest YAML file: the largest example has 4 kB, a label table of a whole body 20 kB."""
VOXEL_BYTES = 4 << 30
"""Largest uncompressed image: a cardiac CT of 512 x 512 x 300 voxels in 20 phases has 3.1 GB."""
DICOM_FILES = 20_000
"""Most images in a folder: a short-axis stack of 20 slices in 30 phases has 600, an examination 5 000."""
GREY_VALUE = 1e12
"""Largest value of a voxel in any unit: scanners store 16 bit, 32 bit reach 4.3e9; damaged float32 3e38."""
AXIS = 1 << 16
"""Most voxels or pixels along an axis; the longest in use, RF lines of ultrasound, have 4 000 to 16 000."""
FRAMES = 1_000_000
"""Most frames or poses in a recording: nine hours at 30/s, or half an hour at 500/s."""
SAMPLES = 200_000_000
"""Most samples of all leads of an ECG: 18 hours of three leads at 1 kHz; as float64 they have 1.6 GB."""
ELEMENTS = 50_000_000
"""Most vertices or triangles of a mesh; whole-heart surfaces have 10 000 to 1 000 000."""
MODEL_BYTES = 2 << 30
"""Largest arrays of a model: 20 phases with knots every 3 mm have 55 MB, every 1 mm 1.5 GB."""
NESTING = 100
"""Deepest nesting of lists in a text; our files have five levels."""
WIRE_TIME_S = 4.0e9
"""Latest stamp accepted from the network (the year 2096): the protocol ends at 2**32 = 4.29e9 s, and answers
stamped on the sender's clock must fit for as long as a session lasts."""
WIRE_IMAGE_BYTES = 64 << 20
"""Largest image accepted from the network: a 3-D ultrasound volume of 400³ voxels."""
WIRE_TEXT_BYTES = (1 << 16) - 1
"""Longest text accepted from the network: the most that OpenIGTLink can state."""
WIRE_FIELDS_BYTES = 1 << 20
"""Largest named fields of a message accepted from the network; PLUS sends some 2 kB."""
WIRE_TOOLS = 128
"""Most tools in one message; trackers see fewer."""


def require_lengths(xyz_mm: Any, what: str) -> None:
    """Refuse coordinates that are not finite or beyond LENGTH_MM.

    Raises:
        InvalidInputError: states the quantity and its value.
    """
    array = np.asarray(xyz_mm, dtype=np.float64)
    if not np.isfinite(array).all():
        raise InvalidInputError(f"{what} holds a value that is not finite; needed numbers in mm")
    if array.size and (far := float(np.abs(array).max())) > LENGTH_MM:
        raise InvalidInputError(
            f"{what} reaches {far:.3g} mm; needed at most {LENGTH_MM:g} mm: check the unit"
        )


def require_times(t_s: Any, what: str) -> None:
    """Refuse times that are not finite or beyond TIME_S.

    Raises:
        InvalidInputError: states the quantity and its value.
    """
    array = np.asarray(t_s, dtype=np.float64)
    if not np.isfinite(array).all():
        raise InvalidInputError(f"{what} holds a time that is not finite; needed seconds")
    if array.size and (late := float(np.abs(array).max())) > TIME_S:
        raise InvalidInputError(f"{what} reaches {late:.3g} s; needed at most {TIME_S:g} s: check the unit")


def require_count(count: int, most: int, what: str) -> None:
    """Refuse more of something than `most`.

    Raises:
        InvalidInputError: states both numbers.
    """
    if count > most:
        raise InvalidInputError(f"it states {count} {what}; at most {most} can be read: copy it again")
