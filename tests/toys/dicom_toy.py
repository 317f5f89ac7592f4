"""DICOM images of tests, written by pydicom, and the short-axis toy as an examination."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from short_axis_toy import PITCH_MM, PIXEL_MM, SCALES, contracting_stack

from dvf_ig.core import Volume
from dvf_ig.io import write_volume


def dicom_image(
    key: str,
    series: str,
    pixels: NDArray[Any],
    corner_mm: NDArray[np.float64],
    axes: NDArray[np.float64],
    spacing_mm: tuple[float, float],
) -> Any:
    """One classic MR image of 16 bits.

    Args:
        key: makes its UID.
        series: name and key of its series.
        pixels: (rows, columns).
        corner_mm: centre of the first pixel.
        axes: rows are the directions of growing column and growing row.
        spacing_mm: between rows, between columns.
    """
    import pydicom
    from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

    data = pydicom.Dataset()
    data.file_meta = pydicom.dataset.FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = MRImageStorage
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid(entropy_srcs=[key])
    data.Modality, data.PatientID, data.PatientName = "MR", "heart-9", "Nobody"
    data.StudyInstanceUID = generate_uid(entropy_srcs=["study"])
    data.SeriesInstanceUID = generate_uid(entropy_srcs=[series])
    data.SeriesDescription, data.FrameOfReferenceUID = series, generate_uid(entropy_srcs=["frame"])
    data.ImagePositionPatient = [round(float(v), 6) for v in corner_mm]
    data.ImageOrientationPatient = [round(float(v), 9) for v in axes.ravel()]
    data.PixelSpacing = list(spacing_mm)
    data.Rows, data.Columns = pixels.shape
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
    data.PixelData = pixels.astype("<u2").tobytes()
    return data


def write_examination(folder: Path) -> None:
    """Write the stack of the short-axis toy as `all`, a file a slice and phase, and its labels."""
    stack, labels = contracting_stack((*SCALES, 0.98, 0.99, 1.0))
    (folder / "all").mkdir(parents=True)
    write_volume(Volume(stack.grid, labels[0]), folder / "labels.nrrd")
    for phase, volume in enumerate(stack.values):
        for number in range(volume.shape[2]):
            key = f"{number} {phase}"
            pixels = np.clip(1000.0 * volume[:, :, number].T, 0, 4000)
            corner_mm = np.array([0.0, 0.0, PITCH_MM * number])
            data = dicom_image(key, f"slice {number}", pixels, corner_mm, np.eye(3)[:2], (PIXEL_MM, PIXEL_MM))
            data.InstanceNumber, data.NominalInterval = phase + 1, 900
            data.TriggerTime = 900.0 * phase / len(stack.values)
            data.save_as(folder / "all" / f"IM{number}{phase}", enforce_file_format=True)
