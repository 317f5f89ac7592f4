"""Files that a run leaves in its folder, after `replay` and after `serve`: result, page, view and poses."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dvf_ig.replay import Replay

RESULT, PAGE = "result.json", "report.html"


def run_files() -> tuple[str, ...]:
    """Names of every file that may be written."""
    from dvf_ig.replay.outputs import NAMES
    from dvf_ig.replay.view_file import STRUCTURE_FILES, VIEW

    return (RESULT, PAGE, VIEW, *NAMES, *STRUCTURE_FILES)


def write_run(
    done: "Replay", result: dict[str, Any], out: Path, recording: Path, model: Path | None
) -> dict[str, str | None]:
    """Write all files of a run or none.

    Args:
        recording: scenario folder, SESSION.yaml or log.
        model: file of the model, if it was named for this run.
    Returns:
        the names of the files, and the frame of the content of each that has one.
    Raises:
        OutputError: not writable.
    """
    from dvf_ig.io import files_together, provenance_fields, write_json, write_text
    from dvf_ig.replay.outputs import write_outputs
    from dvf_ig.replay.page.replay_page import report_html
    from dvf_ig.replay.view_file import VIEW, write_view_file

    with files_together(out, run_files()) as new:
        write_text(new / PAGE, report_html(done, result))
        write_json(new / RESULT, {**result, **provenance_fields()})
        warps = [update.warp for update in done.history.updates if update.pose is not None]
        warp = warps[-1] if warps else None
        frames = write_outputs(done.poses, done.ticks, new, done.scenario.tracked_against, warp)
        write_view_file(done, new, out, recording, model)
    return {RESULT: None, PAGE: None, VIEW: None, **frames}
