"""Shared by the calibration tests: PLUS's real N-wire sweeps with the wires that PLUS found in them."""

from pathlib import Path

import pytest

from dvf_ig.core import NWireRecording
from dvf_ig.io import read_nwire_recording


@pytest.fixture(scope="session")
def real_sweeps(data_dir: Path) -> tuple[NWireRecording, NWireRecording]:
    """The sweep to calibrate with, and the one to validate on."""
    folder = data_dir / "plus-fcal20-nwire"
    device = folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
    points = folder / "FreehandCalibration3NWires_fCal2.0.results.xml"
    name = "fCal_Test_{}_3NWires_fCal2.0.igs.mha"
    first = read_nwire_recording(folder / name.format("Calibration"), device, points, "CalibrationData")
    second = read_nwire_recording(folder / name.format("Validation"), device, points, "ValidationData")
    return first, second
