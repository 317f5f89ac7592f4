"""Read image calibrations from PLUS files: ImageToProbe matrices that are not exactly rigid times scale."""

from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.io.reading import reading

from .xml import parse_xml, read_transforms


def read_image_map(path: Path | str, sensor: str = "probe") -> ImageMap:
    """Read probe_from_image of a PLUS configuration or probe-calibration result.

    PLUS fits each column separately: the first two are made orthogonal, the third, of arbitrary length in
    PLUS's files, is rebuilt. The result's `shear_deg` states how far they were from orthogonal.

    Args:
        path: PLUS XML with `<Transform From="Image" To="Probe">`.
        sensor: name of the sensor's frame.
    Raises:
        UnreadableFileError: absent, not XML, no such transform, or image axes more than 1° off orthogonal.
    """
    path = Path(path)
    name = f"{sensor}_from_image"
    with reading(path, "a PLUS image calibration"):
        transforms = read_transforms(path, parse_xml(path, "a PLUS image calibration"))
        if name not in transforms:
            raise UnreadableFileError(
                f"{path} has no transform {name}; it has {', '.join(sorted(transforms)) or 'none'}: give "
                "the file that holds it, or name its sensor",
                settings=("ultrasound.probe_name",),
            )
        return ImageMap.from_matrix(transforms[name].matrix, sensor)
