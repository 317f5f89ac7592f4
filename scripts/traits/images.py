"""Traits of images: well-formed headers that contradict themselves."""

import random
import re
import struct
from collections.abc import Callable
from pathlib import Path

from scripts.fuzz_readers import READERS
from scripts.fuzz_readers import write_seeds as write_damage_seeds

from . import Target, Trait


def _changed(data: bytes, pattern: str, by: Callable[[re.Match[bytes]], bytes]) -> bytes:
    """Replace the first match in the header; data that stay the same mean that it does not apply."""
    return re.sub(pattern.encode(), by, data, count=1, flags=re.MULTILINE)


def _scaled(text: bytes, factor: float) -> bytes:
    return re.sub(rb"-?\d+(\.\d*)?(e[-+]?\d+)?", lambda m: repr(float(m[0]) * factor).encode(), text)


def _other(text: bytes, rng: random.Random) -> bytes:
    return _scaled(text, rng.choice((0.5, 1.05, 1.5, 2.0)))


def _twice(fields: str) -> Trait:
    """Repeat a field with another value."""
    pattern = rf"^({fields})(: | = )(.*[1-9].*)$"
    return lambda data, rng: _changed(data, pattern, lambda m: m[0] + b"\n" + m[1] + m[2] + _other(m[3], rng))


def _misspelt(fields: str) -> Trait:
    """Drop a letter of a field's name."""

    def trait(data: bytes, rng: random.Random) -> bytes:
        def drop(m: re.Match[bytes]) -> bytes:
            at = rng.randrange(1, len(m[1]))
            return m[1][:at] + m[1][at + 1 :] + m[2]

        return _changed(data, rf"^({fields})(:| =)", drop)

    return trait


def _units(fields: str) -> Trait:
    """Voxel sides in m or um."""
    pattern = rf"^({fields})(: | = )(.*)$"
    return lambda data, rng: _changed(
        data, pattern, lambda m: m[1] + m[2] + _scaled(m[3], rng.choice((1e-3, 1e3)))
    )


def _fewer(field: str) -> Trait:
    """State a voxel less along an axis."""

    def trait(data: bytes, rng: random.Random) -> bytes:
        def less(m: re.Match[bytes]) -> bytes:
            sizes = m[2].split()
            at = rng.randrange(len(sizes))
            sizes[at] = str(max(int(sizes[at]) - 1, 1)).encode()
            return m[1] + b" ".join(sizes)

        return _changed(data, rf"^({field})([\d ]+)$", less)

    return trait


def _added(line: str, before: str) -> Trait:
    return lambda data, rng: _changed(data, rf"^{before}", lambda m: line.encode() + b"\n" + m[0])


def _times(unit: str) -> Trait:
    """Times of the phases in disorder, or of another scale."""

    def trait(data: bytes, rng: random.Random) -> bytes:
        sizes = re.search(rb"^sizes: ([\d ]+)$", data, re.MULTILINE)
        if sizes is None:
            return data
        count = int(sizes[1].split()[-1])
        times = [1000.0 * i / count for i in range(count)]
        if rng.random() < 0.5:
            rng.shuffle(times)
            if times == sorted(times):
                return data
        else:
            times = [t * rng.choice((1e3, 1e-3, 0.0)) for t in times]
        text = f'units: "" "" "" "{unit}"\naxis 3 index values:={" ".join(map(str, times))}'
        return _added(text, "encoding")(data, rng)

    return trait


def _nifti(change: Callable[[bytearray, random.Random], None]) -> Trait:
    def trait(data: bytes, rng: random.Random) -> bytes:
        out = bytearray(data)
        change(out, rng)
        return bytes(out)

    return trait


def _second_geometry(out: bytearray, rng: random.Random) -> None:
    """Move, scale or turn the sform."""
    form = list(struct.unpack_from("<12f", out, 280))
    way = rng.randrange(3)
    if way == 0:
        form[rng.choice((3, 7, 11))] += rng.choice((-20.0, 3.0, 50.0))
    elif way == 1:
        form = [v * 1.05 if i % 4 != 3 else v for i, v in enumerate(form)]
    else:
        form[:3], form[4:7] = [-v for v in form[4:7]], form[:3]
    struct.pack_into("<12f", out, 280, *form)


def _without_codes(out: bytearray, rng: random.Random) -> None:
    struct.pack_into("<2h", out, 252, 0, 0)


def _fewer_voxels(out: bytearray, rng: random.Random) -> None:
    dims = list(struct.unpack_from("<8h", out, 40))
    dims[rng.randrange(1, dims[0] + 1)] -= 1
    struct.pack_into("<8h", out, 40, *dims)


def _other_unit(out: bytearray, rng: random.Random) -> None:
    scale = rng.choice((1e-3, 1e3))
    for at, count in ((80, 3), (268, 3), (280, 12)):
        values = struct.unpack_from(f"<{count}f", out, at)
        struct.pack_into(f"<{count}f", out, at, *(scale * v for v in values))


def _no_geometry(out: bytearray, rng: random.Random) -> None:
    """A quaternion that is none, an unknown unit, or voxels that begin within a byte."""
    form, at, values = rng.choice(
        (("2h3f", 252, (1, 0, 0.9, 0.9, 0.3)), ("b", 123, (rng.choice((4, 5, 6, 7)),)), ("f", 108, (352.5,)))
    )
    struct.pack_into(f"<{form}", out, at, *values)


def _step(out: bytearray, rng: random.Random) -> None:
    """Time between phases in ms where s are stated."""
    if struct.unpack_from("<h", out, 40)[0] == 4:
        struct.pack_into("<f", out, 92, rng.choice((30.0, 45.5, 1e4)))
        out[123] = 10


_NRRD: tuple[Trait, ...] = (
    _twice("sizes|space origin|space directions|type"),
    _misspelt("space origin|space directions|endian"),
    _units("space directions"),
    _fewer("sizes: "),
    _added("spacings: 1.5 2.5 4 1", "encoding"),
    _added("axis mins: 0 10 20 0", "encoding"),
    _added("old min: -5", "encoding"),
    _added('space units: "m" "m" "m"', "encoding"),
)
_META: tuple[Trait, ...] = (
    _twice("Offset|ElementSpacing|TransformMatrix|DimSize"),
    _misspelt("Offset|ElementSpacing|TransformMatrix|CompressedData|DimSize"),
    _units("ElementSpacing"),
    _fewer("DimSize = "),
    _added("HeaderSize = 8", "ElementDataFile"),
    _added("Position = 5 6 7", "ElementDataFile"),
    _added("ElementSize = 5 6 7", "ElementDataFile"),
    _added("DistanceUnits = m", "ElementDataFile"),
    _added("ElementToIntensityFunctionSlope = 2", "ElementDataFile"),
)
_TAGS: dict[str, tuple[object, ...]] = {
    "PatientID": ("someone",),
    "FrameOfReferenceUID": ("1.2.3",),
    "PixelSpacing": ([2.0, 2.0], [0.0014, 0.0016]),
    "ImageOrientationPatient": ([1, 0, 0, 0, 1, 0], [1, 0, 0, 0, 2, 0]),
    "ImagePositionPatient": ([0, 0, 0], [-80, 35.5, 125]),
    "TriggerTime": (2000, "", 1e6),
    "NominalInterval": (1, 30),
    "HeartRate": (20, 240),
    "TemporalPositionIdentifier": (1, 7),
    "NumberOfTemporalPositions": (4, 6),
    "NumberOfFrames": (2,),
    "Modality": ("US", "CT", "SEG"),
    "PhotometricInterpretation": ("MONOCHROME1", "PALETTE COLOR"),
    "SamplesPerPixel": (3,),
    "SOPClassUID": ("1.2.840.10008.5.1.4.1.1.7",),
    "Rows": (4, 16),
    "HighBit": (11,),
    "RescaleSlope": (0,),
    "ImageType": (["ORIGINAL", "PRIMARY", "P", "ND"], ["ORIGINAL", "PRIMARY", "LOCALIZER"]),
    "BitsStored": (8, 12),
    "PixelData": (bytes(94), bytes(192), bytes(10)),
}


def _tag(data: bytes, rng: random.Random) -> bytes:
    """Give one image of a DICOM cine another value of a tag."""
    import io

    from pydicom import dcmread

    image = dcmread(io.BytesIO(data))
    name = rng.choice(sorted(_TAGS))
    setattr(image, name, rng.choice(_TAGS[name]))
    out = io.BytesIO()
    image.save_as(out)
    return out.getvalue()


def _dicom(path: Path) -> object:
    """Order the images of a cine whose tags are read in this process."""
    from unittest.mock import patch

    from dvf_ig.io.dicom.child import read_tags
    from dvf_ig.io.dicom.header import read_images
    from dvf_ig.io.dicom.stack import stack_of

    with patch("dvf_ig.io.dicom.header.read_tags", lambda files: [read_tags(str(file)) for file in files]):
        return stack_of(path.parent.parent, read_images(sorted(path.parent.parent.glob("*/*")))[0])


_NIFTI = tuple(map(_nifti, (_second_geometry, _without_codes, _fewer_voxels, _other_unit, _no_geometry)))
_FILES: dict[str, tuple[str, tuple[Trait, ...]]] = {
    "volume-nrrd": ("volume.nrrd", _NRRD),
    "series-nrrd": ("series.nrrd", (*_NRRD, _times("ms"), _times("%"))),
    "volume-mha": ("volume.mha", _META),
    "series-mha": ("series.mha", _META),
    "volume-nifti": ("volume.nii", _NIFTI),
    "series-nifti": ("series.nii", (*_NIFTI, _nifti(_step))),
    "labels": ("volume.nrrd", _NRRD),
}
TRAITS = {
    name: Target(f"images/{file}", READERS[name][1], traits, contradicts=True)
    for name, (file, traits) in _FILES.items()
} | {"dicom": Target("images/cine/series0/IM0003", _dicom, (_tag,), contradicts=True)}


def write_seeds(folder: Path) -> None:
    """Write the valid files."""
    from tests.io.dicom.test_cine import write

    (folder / "images").mkdir()
    write_damage_seeds(folder / "images")
    write(folder / "images" / "cine")
