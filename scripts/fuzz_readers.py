"""Readers under test, each with small valid files to start from, and the check of accepted values."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig import io
from dvf_ig.core import Points, PoseStream, Volume
from dvf_ig.intake import read_fixtures

Read = Callable[[Path], Any]
GAPS = {"samples", "values", "points_px"}
"""Fields in which NaN marks what was not recorded."""
LARGEST = 1e13


def write_seeds(folder: Path) -> None:
    """Write one scenario and its recordings in other formats."""
    from dvf_ig.intake import write_scenario
    from tests.io.conftest import _make_scenario
    from tests.io.ecg.test_damaged import edf
    from tests.io.model.test_model import model

    scenario: Any = _make_scenario(1)
    write_scenario(scenario, folder / "scenario")
    io.add_ecg_field(folder / "scenario" / "ultrasound.igs.mha", scenario.ecg, folder / "ecg.igs.mha")
    preop, out = scenario.preop, folder
    for ending in ("nrrd", "mha", "nii", "nii.gz", "mhd", "nhdr"):
        io.write_volume(preop.labels.phase(0), out / f"volume.{ending}")
        io.write_volume_series(preop.mr, out / f"series.{ending}")
    io.write_volume(Volume(preop.mr.grid, preop.mr.values[0].astype(np.float32)), out / "grey.mha")
    io.write_volume(Volume(preop.mr.grid, preop.mr.values[0].astype(np.float64)), out / "grey.nii")
    io.write_volume_series(preop.labels, out / "labels.nii")
    mesh = preop.surfaces[0].phase(0)
    for ending in ("obj", "stl", "ply", "vtp"):
        io.write_mesh(mesh, out / f"mesh.{ending}")
    io.write_model(model(1), out / "model.npz")
    io.write_transforms(scenario.start, out / "start.tfm")
    io.write_landmarks(scenario.landmarks_mr, out / "points.mrk.json")
    (out / "points.fcsv").write_text(
        "# CoordinateSystem = RAS\n1,1,2,3,0,0,0,1,1,1,1,A\n2,4,5,6,0,0,0,1,1,1,1,B\n"
    )
    (out / "points.tag").write_text('MNI Tag Point File\nVolumes = 1;\nPoints =\n 1 2 3 "A"\n 4 5 6 "B";\n')
    (out / "points.csv").write_text("x,y,z\n1,2,3\n4,5,6\n")
    (out / "seeds.json").write_text(
        '{"heart": [[1, 2, 3]], "background": [[4, 5, 6]], "cavity": [[7, 8, 9]]}'
    )
    (out / "poses.txt").write_text("".join(f"{i / 10} {i} 2 3 0 0 0 1\n" for i in range(8)))
    (out / "features.csv").write_text("frame,column1_px,row1_px\n0,1,2\n1,3,4\n2,nan,nan\n")
    (out / "trigger.csv").write_text("# delay_s 0.03\nt_s\n0.1\n0.9\n1.7\n")
    (out / "ecg.csv").write_text("t_s,II,V1\n" + "".join(f"{i / 250},{i % 7},{i % 5}\n" for i in range(60)))
    edf(out / "ecg.edf")
    (out / "r.hea").write_text("r 1 250 1500\nr.dat 16 200(0)/mV 16 0 0 0 0 II\n")
    (out / "r.dat").write_bytes(np.arange(2000).astype("<i2").tobytes())
    (out / "m.hea").write_text("m/3 2 250 2000\nlayout 0\nr 1500\n~ 500\n")
    (out / "layout.hea").write_text("layout 2 250 0\n~ 0 200/mV 16 0 0 0 0 II\n~ 0 0 16 0 0 0 0 V\n")
    (out / "r.atr").write_bytes(bytes([10, 4, 200, 4, 0, 236, 0, 0, 44, 1, 5, 20, 2, 252, 40, 78, 0, 0]))
    (out / "session.yaml").write_text(
        "schema: dvf_ig.session/1\npreop: {model: a.npz, organ_labels: [1, 2]}\nultrasound: {file: b.mha}\n"
        "ecg: {file: 'csv:c.csv', start_s: 0.5}\ncalibration: {probe: d.json, latency: 0.03}\ncap_n: 0.5\n"
        "fixtures: [{law: forbidden, depth_mm: 2.0}, {law: path, path: [[1, 2, 3], [4, 5, 6]]}]\n"
    )
    (out / "fixtures.yaml").write_text(
        "cap_n: 0.6\nretiming: uniform\nfixtures:\n  - {law: forbidden, gamma: 1.0}\n"
        "device: {name: omega.3, continuous_force_n: 12, stiffness_n_per_m: 2000}\n"
    )
    matrix: list[list[float]] = [[0.2, 0, 0, 1], [0, 0.2, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    common: dict[str, Any] = {"refused": False, "refused_because": []}
    io.write_json(out / "tip.json", {**common, "kind": "tip", "tip_mm": [1, 2, 3], "tip_frame": "tool"})
    io.write_json(
        out / "probe.json", {**common, "kind": "probe", "sensor_from_image": matrix, "sensor_frame": "probe"}
    )
    io.write_json(out / "lag.json", {**common, "kind": "latency", "lag_s": 0.03})
    (out / "probe.xml").write_text(
        '<PlusConfiguration><CoordinateDefinitions><Transform From="Image" To="Probe" '
        f'Matrix="{" ".join(str(v) for row in matrix for v in row)}" Error="0.3"/></CoordinateDefinitions>'
        "</PlusConfiguration>"
    )
    _write_logs(folder)


def _write_logs(folder: Path) -> None:
    """Write short logs of a replay, and of a live session that was finished or cut off."""
    from toy_ball import ball_model
    from toy_run import TIP, recorded

    from dvf_ig.intake.session_log.live import STATE, STATE_COLUMNS, event_messages
    from dvf_ig.io.ros import messages as ros
    from dvf_ig.io.ros.log_file import LogWriter
    from dvf_ig.session import EcgSamples, ToolPose, TrackedFrame
    from tests.live.test_record import attach
    from tests.replay.test_session_log import logged

    (folder / "run").mkdir()
    log = logged(folder / "run", dataclasses.replace(recorded(), tip=Points("tool", TIP)), given=ball_model())
    log.rename(folder / "log.mcap")
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)
    with (folder / "live.mcap").open("wb") as stream:
        writer = LogWriter(stream, 512)
        attach(writer)
        writer.end_attachments()
        for t_s in (0.0, 0.1, 0.2):
            for event in (
                EcgSamples(t_s, np.full((25, 1), 0.1)),
                TrackedFrame(t_s, image, np.eye(4)),
                ToolPose(t_s, np.eye(4)),
            ):
                for at_s, topic, kind, message in event_messages(event, t_s):
                    writer.write(topic, kind, at_s, message)
            row = np.full(len(STATE_COLUMNS), t_s)
            row[-1] = 0.0
            writer.write(STATE, ros.ARRAY, t_s, ros.array(row, (", ".join(STATE_COLUMNS),)))
        writer.note("lost", 0)
        writer.finish()
    (folder / "live.unfinished.mcap").write_bytes((folder / "live.mcap").read_bytes()[:-700])


def _log(path: Path) -> Any:
    """Read a log; answers of a live session and its refused messages may be anything."""
    from dvf_ig.intake.session_log.read import read_session_log

    recordings = read_session_log(path)
    return [recordings.scenario, recordings.model]


def _tfm(path: Path) -> Any:
    return io.read_transform(path, "mr", "tracker")


def _wire_points(path: Path) -> Any:
    from tests.io.conftest import make_nwire

    phantom = make_nwire(np.random.default_rng(0)).phantom
    return {"points_px": io.read_wire_points(path, "CalibrationData", phantom)}


def _session(path: Path) -> Any:
    from dvf_ig.intake.session import open_session

    return open_session(path)[0]


def _scenario_config(path: Path) -> Any:
    from dvf_ig.intake.scenario import session_of_scenario

    return session_of_scenario(path.parent)


READERS: dict[str, tuple[tuple[str, ...], Read]] = {
    "volume-nrrd": (("volume.nrrd", "volume.nhdr"), io.read_volume),
    "volume-mha": (("volume.mha", "volume.mhd", "grey.mha"), io.read_volume),
    "volume-nifti": (("volume.nii", "volume.nii.gz", "grey.nii"), io.read_volume),
    "series-nrrd": (("series.nrrd", "series.nhdr"), io.read_volume_series),
    "series-mha": (("series.mha",), io.read_volume_series),
    "series-nifti": (("series.nii", "series.nii.gz"), io.read_volume_series),
    "labels": (("volume.nrrd", "volume.nii", "volume.mha", "labels.nii"), io.read_labels),
    "mesh-text": (("mesh.obj",), io.read_mesh),
    "mesh-stl": (("mesh.stl",), io.read_mesh),
    "mesh-ply": (("mesh.ply",), io.read_mesh),
    "mesh-vtp": (("mesh.vtp",), io.read_mesh),
    "model": (("model.npz",), io.read_model),
    "transform": (("start.tfm",), _tfm),
    "landmarks": (("points.mrk.json", "points.fcsv", "points.tag"), lambda p: io.read_landmarks(p, "mr")),
    "points": (("points.csv",), lambda p: io.read_points(p, "mr")),
    "seeds": (("seeds.json",), io.read_seeds),
    "poses": (("poses.txt",), io.read_poses),
    "sequence": (("scenario/ultrasound.igs.mha", "scenario/tool.igs.mha"), io.read_sequence),
    "ecg-field": (("ecg.igs.mha",), lambda p: io.read_ecg(f"plus:{p}")),
    "features": (("features.csv",), lambda p: {"points_px": io.read_feature_points(p)}),
    "wire-phantom": (("scenario/calibration/nwire.xml",), io.read_nwire_phantom),
    "wire-points": (("scenario/calibration/nwire_points.xml",), _wire_points),
    "line-table": (("scenario/calibration/latency_lines.xml",), io.read_line_table),
    "image-map": (("probe.xml",), io.read_image_map),
    "calibrations": (("probe.xml",), io.read_calibrations),
    "tip": (("tip.json",), io.read_tip),
    "probe": (("probe.json",), io.read_probe),
    "lag": (("lag.json",), io.read_lag),
    "ecg-csv": (("ecg.csv",), lambda p: io.read_ecg(f"csv:{p}")),
    "ecg-edf": (("ecg.edf",), lambda p: io.read_ecg(f"edf:{p}")),
    "ecg-wfdb": (("r.hea", "r.dat", "m.hea"), lambda p: io.read_ecg(f"wfdb:{p}")),
    "annotations": (("r.atr",), lambda p: io.read_annotations(f"wfdb:{p}")),
    "trigger": (("trigger.csv",), io.read_triggers),
    "timing": (("scenario/preop/timing.json",), lambda p: io.read_timing(p, folder=p.parent, phases=3)),
    "session": (("session.yaml",), _session),
    "scenario": (("scenario/scenario.yaml",), _scenario_config),
    "fixtures": (("fixtures.yaml",), read_fixtures),
    "log": (("log.mcap", "live.mcap", "live.unfinished.mcap"), _log),
    "truth": (
        ("scenario/truth/truth.json", "scenario/truth/tool.npz"),
        lambda p: io.truth.read_truth(p.parent),
    ),
}


UNLIMITED = {"from_s": -np.inf, "fastest_mm_s": np.inf}
"""Values that mean that there is no limit."""


def unfit(value: Any, name: str = "value") -> str | None:
    """Name the number of an accepted value that is not finite or implausible; None if all are valid."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "f" or not value.size:
            return None
        numbers = value[~np.isnan(value)] if name in GAPS else value
        return None if (np.abs(numbers) <= LARGEST).all() else name
    if isinstance(value, float):
        return None if abs(value) <= LARGEST or UNLIMITED.get(name) == value else name
    if isinstance(value, PoseStream):
        poses = (value.t_s, value.rotations[value.valid], value.translations_mm[value.valid])
        return unfit(poses, value.name)
    parts: list[tuple[str, Any]] = []
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    elif isinstance(value, dict):
        parts = [(str(key), one) for key, one in value.items()]
    elif isinstance(value, list | tuple):
        parts = [("from_s" if name == "mr_from_tracker" else name, one) for one in value]
    elif hasattr(value, "model_dump"):
        return unfit(value.model_dump(), name)
    return next((bad for key, one in parts if (bad := unfit(one, key)) is not None), None)
