"""`dvf-ig synth us`: ultrasound of any labelled volume."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, out_file, wrote

if TYPE_CHECKING:
    from data_synth import LabelAnatomy, Tissue
    from dvf_ig.core import FloatArray, Rigid

Triple = tuple[float, float, float]

VIEW = "apical four-chamber"
"""View if neither a view nor a position is given."""


def us(
    labels: Annotated[Path, Option(help="Label volume: NIfTI, NRRD or MetaImage.")],
    out: Annotated[Path, out_file("Image to write: .png, or .nrrd/.mha/.nii.gz.")],
    probe: Annotated[
        str | None, Option(help="epicardial, apical, tee, curvilinear, ice or matrix (3-D).")
    ] = None,
    tissues: Annotated[
        Path | None, Option(help="YAML or JSON: label number to tissue name (default: whole heart).")
    ] = None,
    view: Annotated[str | None, Option(help=f"Standard view (default: {VIEW}).")] = None,
    eye: Annotated[
        Triple | None, Option(help="Probe's position instead of a view: x y z in mm, LPS.")
    ] = None,
    towards: Annotated[
        Triple | None, Option(help="With --eye: point to look at (default: the heart).")
    ] = None,
    roll_deg: Annotated[float, Option(help="With --eye: turn about the viewing direction.")] = 0.0,
    as_json: JsonFlag = False,
    seed: SeedOption = 1,
    threads: ThreadsOption = None,
) -> None:
    """Simulate an ultrasound image of a labelled volume.

    Blood pools get thin walls and valves, the heart gets fat and pericardium. An image volume has its
    pose in the labels' space, one slice for a plane; a .png does not.
    """
    with command(threads):
        from data_synth import VIEW_PROBE, label_anatomy, probe_named
        from dvf_ig.core import InvalidInputError
        from dvf_ig.io import read_volume

        if view is not None and eye is not None:
            raise typer.BadParameter("--view and --eye exclude each other")
        if eye is None and (towards is not None or roll_deg != 0):
            raise typer.BadParameter("--towards and --roll-deg belong to --eye")
        name = probe or (VIEW_PROBE.get(view or VIEW, "apical") if eye is None else "epicardial")
        if name == "matrix" and out.suffix.lower() == ".png":
            raise InvalidInputError("a 3-D image does not fit a .png; write .nrrd, .mha or .nii.gz")
        chosen = probe_named(name)
        anatomy = label_anatomy(read_volume(labels), _tissues(tissues))
        pose = _pose(anatomy, view, eye, towards, roll_deg)
        facts = _write(anatomy, chosen, pose, seed, out)
        facts = {
            "image": str(out),
            "probe": name,
            "seed": seed,
            **facts,
            "mr_from_plane": pose.matrix.tolist(),
        }
        size = " x ".join(map(str, facts["shape"]))
        rows = [("probe", name), ("image", size), ("mean grey in the sector", f"{facts['mean_grey']:.1f}")]
        emit(facts, rows, as_json=as_json)
        wrote(out, "image" if out.suffix.lower() == ".png" else "mr")


def _tissues(path: Path | None) -> "dict[int, Tissue] | None":
    """Read label numbers to tissues from a YAML (or JSON) mapping of numbers to names."""
    if path is None:
        return None
    from data_synth.heart.tissue import Tissue
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io.yaml_config import read_yaml

    document = read_yaml(path, "a map from labels to tissues")
    if not isinstance(document, dict) or not document:
        raise InvalidInputError(f"{path} holds no mapping; needed lines such as '3: lv_blood'")
    tissues = {tissue.name.lower(): tissue for tissue in Tissue}
    out = {}
    for label, tissue in document.items():
        if not label.isdecimal() or str(tissue).lower() not in tissues:
            raise InvalidInputError(
                f"{path}: '{label}: {tissue}' is not a label number and a tissue; "
                f"tissues are {', '.join(tissues)}"
            )
        out[int(label)] = tissues[str(tissue).lower()]
    return out


def _pose(
    anatomy: "LabelAnatomy", view: str | None, eye: Triple | None, towards: Triple | None, roll_deg: float
) -> "Rigid":
    """Choose mr_from_plane of the requested view or position."""
    import numpy as np

    from data_synth.ultrasound.views import standard_view, view_from

    if eye is None:
        return standard_view(view or VIEW, anatomy.reference)
    target: FloatArray = anatomy.center_mm if towards is None else np.array(towards)
    return view_from(np.array(eye), target, float(np.deg2rad(roll_deg)))


def _write(anatomy: "LabelAnatomy", probe: Any, pose: "Rigid", seed: int, out: Path) -> dict[str, Any]:
    """Simulate and write an image; return facts on it."""
    import numpy as np

    from data_synth import MatrixProbe, simulate_frame, simulate_volume
    from dvf_ig.core import Grid, Volume
    from dvf_ig.io import write_volume

    if isinstance(probe, MatrixProbe):
        still = np.zeros((probe.tall, probe.sector.lines))
        volume = simulate_volume(anatomy, probe, pose, still, seed=seed)
        values, grid = volume.image.values, volume.image.grid
        seen = values[volume.mask.values > 0]
        origin, spacing = pose.apply_array(grid.origin_mm), grid.spacing_mm
    else:
        image = simulate_frame(anatomy, probe, pose, np.zeros(probe.lines), seed=seed, frame=0)
        seen = image[probe.fan.mask(*image.shape)]
        values = image.T[:, :, None]
        corner = probe.plane_from_image.apply_pixels(np.zeros((1, 2))).xyz_mm[0]
        origin, spacing = pose.apply_array(corner), np.array([*probe.mm_per_px, 1.0])
        if out.suffix.lower() == ".png":
            _write_png(image, out)
    if out.suffix.lower() != ".png":
        write_volume(Volume(Grid("mr", values.shape, origin, spacing, pose.rotation), values), out)
    return {"shape": [n for n in values.shape if n > 1], "mean_grey": float(seen.mean())}


def _write_png(image: Any, out: Path) -> None:
    """Write an 8-bit grey PNG."""
    from io import BytesIO

    from PIL import Image

    from dvf_ig.io.writing.atomic import write_bytes

    buffer = BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    write_bytes(out, buffer.getvalue())
