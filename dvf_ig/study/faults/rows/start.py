"""Rows of the table whose faults a start must refuse."""

import numpy as np

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.start_trial import (
    PATIENT,
    RAS,
    Start,
    StartFault,
    calibrated_off,
    marked_in,
    of_patient,
    pose_file_scaled,
    posed_in,
    with_bytes_changed,
)

from .row import Row, Severity

AT_START = "before the first force"
SAME = np.ones(3)


def _refused(label: str, start: Start, clean: Start) -> Severity:
    return Severity(label, StartFault(start, clean), 0.0)


START_ROWS: tuple[Row, ...] = (
    Row(
        "LPS/RAS",
        Hazard.NONE,
        AT_START,
        (
            _refused(
                "marked landmarks in RAS, heart on the axis of the flip",
                marked_in(RAS, on_axis=True),
                marked_in(SAME, on_axis=True),
            ),
            _refused("marked landmarks in RAS", marked_in(RAS), marked_in(SAME)),
            _refused("start pose in RAS", posed_in(RAS), posed_in(SAME)),
        ),
    ),
    Row(
        "probe calibration",
        Hazard.NONE,
        AT_START,
        (
            _refused("known points 1.3 mm off", calibrated_off(1.3), calibrated_off(0.0)),
            _refused("known points 3 mm off", calibrated_off(3.0), calibrated_off(0.0)),
            _refused("known points 8 mm off", calibrated_off(8.0), calibrated_off(0.0)),
        ),
    ),
    Row(
        "shear or scale: start pose",
        Hazard.NONE,
        AT_START,
        (
            _refused("0.06 % of scale", pose_file_scaled(1.0006), pose_file_scaled(1.0)),
            _refused("1 % of scale", pose_file_scaled(1.01), pose_file_scaled(1.0)),
            _refused("mirrored", pose_file_scaled(-1.0), pose_file_scaled(1.0)),
        ),
    ),
    Row(
        "model of another patient",
        Hazard.NONE,
        AT_START,
        (
            _refused("a name with another capital", of_patient(PATIENT.upper()), of_patient(PATIENT)),
            _refused("one bit of the file changed", with_bytes_changed(1), with_bytes_changed(0)),
            _refused("100 bits of the file changed", with_bytes_changed(100), with_bytes_changed(0)),
        ),
    ),
)
