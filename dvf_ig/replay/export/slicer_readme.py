"""README of a Slicer scene folder: the content of each file, and how to load it."""

from collections.abc import Mapping

from .exported_run import ExportedRun

_HEAD = """# 3D Slicer scene: {title}

Open `scene.mrml` (File > Add Data, or drag it into 3D Slicer 5). Everything below is loaded and placed. Press
play in the Sequences toolbar: `recording` moves ultrasound, probe, tool and registration together ({frames}
frames, seconds on the tracker's clock); `heart cycle` plays the pre-operative images, where there are any.

This is research software, not a medical device: nothing here may guide a treatment.

## How things hang together

The scene is that of the pre-operative images (RAS). What was tracked hangs on `{root}`:

    {root:<24}the registration: diag(-1, -1, 1) mr_from_tracker, mm
      {probe:<24}probe at the moment that the image shows (latency {lag_ms:.1f} ms taken off)
        ImageToProbe          image calibration: pixels to mm
          ultrasound
      {tool:<24}where a tool and its tip are known
        tool_tip
      landmarks_touched

Coordinates of devices are taken as they stand, as Slicer takes those of PLUS and OpenIGTLink. So a PLUS
sequence of the same tracker can be put under `{root}` as it is, and live poses too.
{poses} {bound}

## File by file

| file | frame | how to load it alone |
|---|---|---|
"""

_TAIL = """
A `.tfm` here is the file of its Slicer node: load it and apply it as it is. It is not `mr_from_tracker.tfm`
of the run, whose points are LPS on both sides.

## The heart's surface as a sequence

The {phases} surfaces are models of their own, of which end-diastole is shown. To play them, paste this into
the Python console (View > Python Console):

    import slicer
    browser = slicer.util.getNode("heart cycle") if slicer.util.getNodes("heart cycle") else \\
        slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSequenceBrowserNode", "heart cycle")
    sequence = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSequenceNode", "heart")
    sequence.SetIndexName("phase"); sequence.SetIndexUnit("RR"); sequence.SetIndexType(0)
    for i, fraction in enumerate([{fractions}]):
        sequence.SetDataNodeAtValue(slicer.util.getNode("heart_%03d" % i), "%.6g" % fraction)
    browser.AddSynchronizedSequenceNode(sequence)
"""

_HOW = (
    ("scene.mrml", "all of it at once"),
    ("README.md", "this text"),
    (".seq.mha", "Add Data as *Transform Sequence*; Sequences module to play it"),
    (".seq.nrrd", "Add Data as *Volume Sequence*; Sequences module to play it"),
    (".seg.nrrd", "Add Data as *Segmentation*; each segment's tags hold its tissue's properties"),
    (".tfm", "Add Data as *Transform*; apply it as loaded"),
    (".mha", "Add Data as *Volume*"),
    (".stl", "Add Data as *Model* (LPS, as the file says)"),
    (".mrk.json", "Add Data as *Markups*; each point's description holds its bound"),
)


def readme_text(frames: Mapping[str, str], run: ExportedRun, shown: int, fractions: tuple[float, ...]) -> str:
    """Write the README's text.

    Args:
        frames: frame of each file's content, by file name.
        shown: number of ultrasound frames.
        fractions: position of each surface in the cycle.
    """
    root = next(name for name in frames if name.endswith("ToRas.tfm")).removesuffix(".tfm")
    tracker = root.removesuffix("ToRas")
    poses, bound = len(run.poses), run.bound_mm
    head = _HEAD.format(
        title=run.scenario.name,
        frames=shown,
        root=root,
        probe=f"ProbeTo{tracker}",
        tool=f"ToolTo{tracker}",
        lag_ms=1000 * run.ultrasound.lag_s,
        poses="The registration is one pose."
        if poses == 1
        else f"The registration is that of the moment ({poses} poses), with the motion in breathing where it "
        "was followed; frames before the first are shown with the first, and frames while it was suspended "
        "are left out.",
        bound="No bound on its error was stated."
        if bound is None
        else f"Its error over the heart lies below {bound:.1f} mm with 95 % probability.",
    )
    rows = [f"| `{name}` | {frame} | {_how(name)} |\n" for name, frame in _one_surface(frames)]
    listed = ", ".join(f"{fraction:.6g}" for fraction in fractions)
    return head + "".join(rows) + _TAIL.format(phases=len(fractions), fractions=listed)


def _one_surface(frames: Mapping[str, str]) -> list[tuple[str, str]]:
    """List every file, the surfaces of the cycle in one row."""
    surfaces = [name for name in frames if name.endswith(".stl") and not name.startswith("heart_now")]
    rows = [(name, frame) for name, frame in frames.items() if name not in surfaces[1:]]
    if len(surfaces) > 1:
        place = rows.index((surfaces[0], frames[surfaces[0]]))
        rows[place] = (f"{surfaces[0]}` to `{surfaces[-1]}", rows[place][1])
    return rows


def _how(name: str) -> str:
    return next(how for ending, how in _HOW if name.endswith(ending))
