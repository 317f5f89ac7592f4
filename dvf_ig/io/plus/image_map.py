"""Image calibrations out of PLUS files: ImageToProbe matrices that are not quite rigid times scale."""

from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.io.reading import reading

from .xml import parse_xml, read_transforms


def read_image_map(path: Path | str, sensor: str = "probe") -> ImageMap:
    """probe_from_image of a PLUS configuration or probe-calibration result.

    The columns of such a matrix are a fit of their own each: the first two are made orthogonal, the third,
    of arbitrary length in PLUS's files, is rebuilt. How far they were off is `shear_deg` of the result.

    Args:
        path: PLUS XML with `<Transform From="Image" To="Probe">`.
        sensor: name of the frame that the image is placed in, where it is not "probe".
    Raises:
        UnreadableFileError: absent, not XML, no such transform, or image axes more than 1° off orthogonal.
    """
    path = Path(path)
    name = f"{sensor}_from_image"
    with reading(path, "a PLUS image calibration"):
        found = read_transforms(path, parse_xml(path, "a PLUS image calibration"))
        if name not in found:
            raise UnreadableFileError(
                f"{path} has no transform {name}; it has {', '.join(sorted(found)) or 'none'}: give "
                "the file that holds it, or name its sensor",
                settings=("ultrasound.probe_name",),
            )
        return ImageMap.from_matrix(found[name].matrix, sensor)
