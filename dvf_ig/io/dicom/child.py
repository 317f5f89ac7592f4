"""Read tags and pixels of DICOM files: run as a process of its own, whose time and memory `process` limits.

It imports nothing of this package: its parent starts it as a script.
"""

import json
import resource
import sys
from typing import Any

GENERAL = (
    "PatientID SeriesInstanceUID SeriesDescription FrameOfReferenceUID InstanceNumber Rows Columns "
    "SamplesPerPixel PhotometricInterpretation NumberOfFrames NumberOfTemporalPositions "
    "CardiacNumberOfImages Modality ImageType BitsAllocated BitsStored HighBit SOPClassUID"
)
"""Keywords that a file states once."""
OF_FRAME = (
    "ImagePositionPatient ImageOrientationPatient PixelSpacing SliceThickness SpacingBetweenSlices "
    "TriggerTime NominalCardiacTriggerDelayTime ActualCardiacTriggerDelayTime "
    "NominalPercentageOfCardiacPhase RRIntervalTimeNominal NominalInterval HeartRate "
    "TemporalPositionIdentifier TemporalPositionIndex RescaleSlope RescaleIntercept"
)
"""Keywords that each frame of an enhanced image may state, or all share."""
UNKNOWN_LENGTH = 0xFFFFFFFF
"""Length of compressed pixels, which come in pieces."""
DEFERRED_BYTES = 4096
"""Longer values are not read before they are needed."""
SEQUENCES = "SharedFunctionalGroupsSequence PerFrameFunctionalGroupsSequence ModalityLUTSequence"


def read_tags(path: str) -> dict[str, Any]:
    """Read the stated tags of a file by keyword, and those of each of its frames: every differing value."""
    import pydicom

    keywords = f"{GENERAL} {OF_FRAME} {SEQUENCES}".split()
    data = pydicom.dcmread(path, defer_size=DEFERRED_BYTES, specific_tags=[*keywords, "PixelData"])
    pixels = data.get_item("PixelData")
    length = None if pixels is None else getattr(pixels, "length", len(pixels.value or b""))
    general = {name: _text(data, name) for name in GENERAL.split() if name in data}
    shared = [data, *_groups(data.get("SharedFunctionalGroupsSequence") or [])]
    frames = data.get("PerFrameFunctionalGroupsSequence")
    items = [shared] if frames is None else [[*shared, *_groups([item])] for item in frames]
    names = OF_FRAME.split()
    return {
        "general": general,
        "pixels": pixels is not None,
        "table": "ModalityLUTSequence" in data,
        "pixel_bytes": None if length == UNKNOWN_LENGTH else length,
        "enhanced": frames is not None,
        "frames": [
            {n: texts for n in names if (texts := list(dict.fromkeys(_text(g, n) for g in item if n in g)))}
            for item in items
        ],
    }


def _groups(items: Any) -> list[Any]:
    """List the data sets inside the functional groups of `items`."""
    return [group for item in items for element in item if element.VR == "SQ" for group in element.value]


def _text(data: Any, keyword: str) -> str:
    value = data[keyword].value
    if value is None:
        return ""
    return "\\".join(map(str, value)) if data[keyword].VM > 1 else str(value).strip(" \0")


def write_pixels(path: str, out: Any, size: list[int]) -> None:
    """Append the rescaled grey levels of every frame, float32, by GDCM, which knows all compressions."""
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    SimpleITK.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    reader = SimpleITK.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(path)
    reader.ReadImageInformation()
    if list(reader.GetSize())[:2] != size or reader.GetNumberOfComponents() != 1:
        sys.exit(3)
    image = SimpleITK.Cast(reader.Execute(), SimpleITK.sitkFloat32)
    out.write(SimpleITK.GetArrayViewFromImage(image).tobytes())


def _answer(**line: Any) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Read the files of the task on stdin; answer a line as each begins, and one with its tags."""
    task = json.loads(sys.stdin.read())
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    out = open(task["pixels"], "wb") if task["pixels"] else None  # noqa: SIM115  the process ends with it
    for path in task["files"]:
        _answer(begun=path)
        if out is None:
            _answer(tags=read_tags(path))
        else:
            write_pixels(path, out, task["size"])
    if out is not None:
        out.close()
    _answer(done=True)


if __name__ == "__main__":
    main()
