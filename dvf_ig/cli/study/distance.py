"""`dvf-ig study distance`: methods that make a distance map, side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, progress, wrote

from .options import FirstSeedOption, SeedsOption

if TYPE_CHECKING:
    from dvf_ig.core import Mesh
    from dvf_ig.study.distance.maps import MapScore


def distance_maps(
    out: Annotated[
        Path,
        typer.Option("-o", "--out", callback=output_dir, help="Folder for summary.json and the picture."),
    ],
    surface: Annotated[
        Path | None,
        typer.Argument(help="Closed surface (.stl .ply .vtp .obj); default: the phantom's hearts."),
    ] = None,
    voxels: Annotated[int, typer.Option("--voxels", min=24, help="Along the longest side.")] = 128,
    seeds: SeedsOption = 1,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Dilation, Euclidean maps, smoothed masks and exact distances, held against the exact one."""
    with command(lists_inputs=False):
        import numpy as np

        from dvf_ig.io import files_together, output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.distance_maps import distance_maps_png
        from dvf_ig.study.distance.maps import WIDE_MM, compare_distance_maps

        meshes, name = _surfaces(surface, range(seed, seed + seeds))
        rngs = [np.random.default_rng(seed + k) for k in range(len(meshes))]
        with output_folder(out, ["summary.json", "distance.png"]), progress("distance maps") as report:
            found = compare_distance_maps(meshes, rngs, voxels=voxels, progress=report)
            summary = {
                "surface": name,
                "vertices": len(meshes[0].vertices_mm),
                "voxel_mm": float(found.grid.spacing_mm[0]),
                "shape": list(found.grid.shape),
                "seed": seed,
                "seeds": seeds,
                "rows": [_entry(score) for score in found.scores],
            }
            title = f"Distance maps of {name}, voxels of {found.grid.spacing_mm[0]:.2f} mm"
            picture = distance_maps_png(found.scores, found.exact_mm, title, within_mm=WIDE_MM)
            with files_together(out) as new:
                write_json(new / "summary.json", summary)
                write_bytes(new / "distance.png", picture)
        emit(summary, _rows(found.scores), as_json=as_json)
        wrote(out / "summary.json")
        wrote(out / "distance.png")


def _surfaces(path: Path | None, seeds: Sequence[int]) -> "tuple[list[Mesh], str]":
    """The file's surface, or the phantom's of each seed, and what to call them."""
    from dvf_ig.core import InvalidInputError, Mesh
    from dvf_ig.io import read_mesh
    from dvf_ig.preop import count_edges

    if path is None:
        from data_synth.heart.anatomy import phantom_anatomy

        phantoms = [phantom_anatomy(motion="paper5mm", mismatch_mm=0.0, seed=seed) for seed in seeds]
        which = f"phantom {seeds[0]}" if len(seeds) == 1 else f"phantoms {seeds[0]} to {seeds[-1]}"
        return [Mesh("mr", p.ed_vertices_mm, p.triangles) for p in phantoms], f"{which}, end-diastole"
    if len(seeds) > 1:
        raise typer.BadParameter(f"--seeds is {len(seeds)}, but {path} is one surface; leave out one of them")
    mesh = read_mesh(path)
    census = count_edges(mesh.triangles)
    if not census.closed:
        raise InvalidInputError(f"{path} is not a closed surface: {census}; close it first")
    if mesh.volume_mm3() < 0.0:
        mesh = Mesh(mesh.frame, mesh.vertices_mm, mesh.triangles[:, ::-1])
    return [mesh], path.name


def _entry(score: "MapScore") -> dict[str, str | float]:
    return {
        "name": score.name,
        "seconds": score.seconds,
        "rms_15mm_mm": score.rms_wide_mm,
        "rms_2mm_mm": score.rms_near_mm,
        "surface_mean_mm": score.surface_mean_mm,
        "surface_sd_mm": score.surface_sd_mm,
        "normal_median_deg": score.normal_median_deg,
        "normal_p95_deg": score.normal_p95_deg,
        "map_normal_median_deg": score.map_normal_median_deg,
        "map_normal_p95_deg": score.map_normal_p95_deg,
    }


def _rows(scores: "tuple[MapScore, ...]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("", "time", "map RMS, mm", "", "map normal, °", "", "fitted surface", "fitted normal, °", ""),
        ("", "s", "< 15 mm", "< 2 mm", "median", "p95", "mm", "median", "p95"),
    ]
    rows += [
        (
            score.name,
            f"{score.seconds:.2f}",
            f"{score.rms_wide_mm:.2f}",
            f"{score.rms_near_mm:.2f}",
            f"{score.map_normal_median_deg:.1f}",
            f"{score.map_normal_p95_deg:.1f}",
            f"{score.surface_mean_mm:.3f} ± {score.surface_sd_mm:.3f}",
            f"{score.normal_median_deg:.2f}",
            f"{score.normal_p95_deg:.2f}",
        )
        for score in scores
    ]
    return rows
