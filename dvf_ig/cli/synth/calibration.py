"""`dvf-ig synth calibration`: one calibration recording with its images and its truth."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, out_folder, wrote

if TYPE_CHECKING:
    import numpy as np

    from data_synth.phantoms.tank import TankRecording
    from data_synth.scenario.ground_truth import GroundTruth
    from dvf_ig.core import FloatArray


Kind = Literal["pivot", "nwire", "cross-wire", "wall", "watertank"]


@dataclass(frozen=True, slots=True)
class RecordingFiles:
    """Parts of a recording: truth as JSON, and (file, content, frame) of each file."""

    truth: dict[str, Any]
    files: tuple[tuple[str, str, str], ...]


def calibration(
    kind: Annotated[Kind, Argument(help="Which recording.")],
    out: Annotated[Path, out_folder("Folder to write.")],
    as_json: JsonFlag = False,
    seed: SeedOption = 1,
    threads: ThreadsOption = None,
) -> None:
    """Simulate one calibration recording: tracked poses, images, segmented features, ground truth."""
    with command(threads):
        import numpy as np

        from data_synth import SectorProbe, child_rng, draw_ground_truth
        from dvf_ig.io import files_together, output_folder, write_json, write_text

        truth = draw_ground_truth(
            np.zeros(3), SectorProbe().plane_from_image, 150.0, child_rng(seed, "planting")
        )
        with output_folder(out), files_together(out) as new:
            recording = _MAKERS[kind](truth, new, child_rng(seed, kind.replace("-", "")))
            write_json(new / "truth.json", {"kind": kind, "seed": seed, **recording.truth})
            write_text(new / "README.md", _readme(kind, seed, recording))
        emit(
            {"kind": kind, "folder": str(out), "files": [name for name, _, _ in recording.files]},
            [(name, content) for name, content, _ in recording.files],
            as_json=as_json,
        )
        for name, _, frame in recording.files:
            wrote(out / name, frame)
        wrote(out / "truth.json")
        wrote(out / "README.md")


def _pivot(truth: "GroundTruth", out: Path, rng: "np.random.Generator") -> RecordingFiles:
    from data_synth import Preset, pivot_recording
    from dvf_ig.io import write_poses

    write_poses(pivot_recording(truth.tip_in_tool, Preset().pivot_tracker, rng), out / "pivot.igs.mha")
    tip = {"tip_mm": truth.tip_in_tool.xyz_mm[0], "tip_frame": truth.tip_in_tool.frame}
    return RecordingFiles(
        tip, (("pivot.igs.mha", "poses while the tip rests in a divot", "tracker_from_tool"),)
    )


def _nwire(truth: "GroundTruth", out: Path, rng: "np.random.Generator") -> RecordingFiles:
    from data_synth import Preset, SectorProbe, nwire_images
    from dvf_ig.core import PoseStream, Rigid, TrackedSequence
    from dvf_ig.io import write_nwire_phantom, write_sequence, write_wire_points

    options = Preset()
    recording, images = nwire_images(
        truth.probe_from_image, SectorProbe(), options.nwire_tracker, options.nwire, rng
    )
    probe = recording.phantom_from_probe
    # the phantom is its own reference
    poses = PoseStream(
        "reference", probe.source, probe.t_s, probe.rotations, probe.translations_mm, probe.valid
    )
    sequence = TrackedSequence(images.t_s, images.images, images.image_valid, {poses.name: poses})
    write_sequence(sequence, out / "nwire.igs.mha")
    write_nwire_phantom(out / "nwire.xml", recording.phantom, Rigid.identity("reference", "phantom"))
    write_wire_points(out / "nwire_points.xml", "CalibrationData", recording.phantom, recording.points_px)
    return RecordingFiles(
        _image_truth(truth),
        (
            ("nwire.igs.mha", f"{len(sequence)} images with poses", "reference_from_probe"),
            ("nwire.xml", "device set: wires, and where the phantom stands", "phantom"),
            ("nwire_points.xml", "segmented wires, px", "image"),
        ),
    )


def _crosswire(truth: "GroundTruth", out: Path, rng: "np.random.Generator") -> RecordingFiles:
    from data_synth import CrossWireSpec, Preset, SectorProbe, crosswire_recording

    crossing = crosswire_recording(
        truth.probe_from_image, SectorProbe(), Preset().nwire_tracker, CrossWireSpec(), rng
    )
    files = _write_tank(out, "cross-wire", crossing.recording, "the crossing in each image, px")
    return RecordingFiles({**_image_truth(truth), "crossing_tracker_mm": crossing.crossing.xyz_mm[0]}, files)


def _wall(truth: "GroundTruth", out: Path, rng: "np.random.Generator") -> RecordingFiles:
    from data_synth import Preset, SectorProbe, WallSpec, wall_recording

    wall = wall_recording(truth.probe_from_image, SectorProbe(), Preset().nwire_tracker, WallSpec(), rng)
    files = _write_tank(out, "wall", wall.recording, "two points of the wall's line in each image, px")
    plane = {"wall_normal_tracker": wall.normal, "wall_offset_mm": wall.offset_mm}
    return RecordingFiles({**_image_truth(truth), **plane}, files)


def _watertank(truth: "GroundTruth", out: Path, rng: "np.random.Generator") -> RecordingFiles:
    from data_synth import Preset, SectorProbe, watertank_images
    from dvf_ig.io import write_line_table, write_poses, write_sequence

    options = Preset()
    recording, video = watertank_images(
        truth.probe_from_image, SectorProbe(), truth.lag_s, options.watertank_tracker, options.watertank, rng
    )
    write_poses(recording.tracker_from_probe, out / "tracker.igs.mha")
    write_sequence(video, out / "video.igs.mha")
    middle = 0.5 * (SectorProbe().columns - 1)
    write_line_table(out / "lines.xml", recording.wall_row_px.values, middle)
    return RecordingFiles(
        {**_image_truth(truth), "lag_s": truth.lag_s},
        (
            ("tracker.igs.mha", "poses, tracker clock", "tracker_from_probe"),
            ("video.igs.mha", f"{len(video)} images, video clock", "image"),
            ("lines.xml", "the floor's row in each image, px", "image"),
        ),
    )


_MAKERS: dict[Kind, "Callable[[GroundTruth, Path, np.random.Generator], RecordingFiles]"] = {
    "pivot": _pivot,
    "nwire": _nwire,
    "cross-wire": _crosswire,
    "wall": _wall,
    "watertank": _watertank,
}


def _write_tank(
    out: Path, name: str, recording: "TankRecording", content: str
) -> tuple[tuple[str, str, str], ...]:
    from dvf_ig.io import write_sequence, write_text

    write_sequence(recording.sequence, out / f"{name}.igs.mha")
    write_text(out / f"{name}_points.csv", _points_csv(recording.features_px))
    return (
        (f"{name}.igs.mha", f"{len(recording.sequence)} images with poses", "tracker_from_probe"),
        (f"{name}_points.csv", content, "image"),
    )


def _points_csv(features_px: "FloatArray") -> str:
    """Format one row an image; empty if the segmentation failed."""
    count = features_px.shape[1]
    head = ["frame", *(f"{axis}{k + 1}_px" for k in range(count) for axis in ("column", "row"))]
    lines = [",".join(head)]
    for frame, points in enumerate(features_px.reshape(len(features_px), -1).tolist()):
        lines.append(",".join([str(frame), *("" if value != value else repr(value) for value in points)]))
    return "\n".join(lines) + "\n"


def _image_truth(truth: "GroundTruth") -> dict[str, Any]:
    return {"probe_from_image": truth.probe_from_image.matrix}


def _readme(kind: Kind, seed: int, made: RecordingFiles) -> str:
    rows = [f"| `{name}` | {content} | {frame} |" for name, content, frame in made.files]
    return "\n".join(
        [
            f"# Synthetic {kind} calibration, seed {seed}",
            "",
            "Lengths in mm, times in s. `target_from_source` maps coordinates of the source frame to the "
            "target frame; `image` is in pixels (column, row). `truth.json` holds the ground truth: do not "
            "read it before comparing.",
            "",
            "| file | content | frame |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )
