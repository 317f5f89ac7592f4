"""`dvf-ig calibrate pivot`: the tool tip from poses recorded while it rested in a divot."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command

from .output import MaxResidualOption, OutputOption, judge, marked, save, show, vector, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import PivotResult


def pivot(
    poses: Annotated[
        Path, typer.Argument(help="PLUS sequence, folder of 4x4 texts, or table x y z qx qy qz qw.")
    ],
    tool: Annotated[str | None, typer.Option("--tool", help="Frame of the tool in a sequence.")] = None,
    max_residual_mm: MaxResidualOption = None,
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Tool tip from poses recorded while the tip rested in a divot."""
    with command():
        import numpy as np

        from dvf_ig.calibration import PivotOptions, calibrate_pivot
        from dvf_ig.io import read_poses
        from dvf_ig.report import write_residual_picture

        options = PivotOptions()
        if max_residual_mm is not None:
            options = PivotOptions(max_rms_mm=max_residual_mm)
        recorded = read_poses(poses, source=tool)
        found = calibrate_pivot(recorded, rng=np.random.default_rng(seed), options=options)
        result = {**_result(found), "max_residual_mm": options.max_rms_mm}
        matrix = np.eye(4)
        matrix[:3, 3] = result["tip_mm"]
        name = f"{found.tip.frame}_from_{found.tip.frame}_tip"
        title = marked(
            result,
            f"Tool tip of '{found.tip.frame}': {found.rms_3d_mm:.2f} mm RMS over {int(found.inliers.sum())} "
            f"of {found.poses} poses that span {found.span_deg:.0f}°",
        )
        save(
            output, result, name, matrix, found.rms_3d_mm,
            lambda png: write_residual_picture(png, found.residuals_mm, title=title, used=found.inliers),
        )  # fmt: skip
        show(result, _rows(found), as_json=as_json)
        judge(result)


def _result(found: "PivotResult") -> dict[str, Any]:
    import numpy as np

    return {
        "kind": "tip",
        **verdict(found.refusals),
        "tip_mm": found.tip.xyz_mm[0].tolist(),
        "pivot_mm": found.pivot.xyz_mm[0].tolist(),
        "rms_3d_mm": found.rms_3d_mm,
        "rms_per_coordinate_mm": found.rms_per_coordinate_mm,
        "inliers": int(found.inliers.sum()),
        "poses": found.poses,
        "span_deg": found.span_deg,
        "condition": found.condition,
        "tip_sd_mm": np.sqrt(np.diag(found.covariance)[:3]).tolist(),
        "tip_frame": found.tip.frame,
        "pivot_frame": found.pivot.frame,
    }


def _rows(found: "PivotResult") -> list[tuple[str, str]]:
    residual = f"{found.rms_3d_mm:.3f} mm RMS (3-D), {found.rms_per_coordinate_mm:.3f} per coordinate"
    return [
        ("tip", f"{vector(found.tip.xyz_mm[0].tolist())} mm in '{found.tip.frame}'"),
        ("pivot", f"{vector(found.pivot.xyz_mm[0].tolist())} mm in '{found.pivot.frame}'"),
        ("residual", residual),
        ("poses used", f"{int(found.inliers.sum())} of {found.poses}"),
        ("angular span", f"{found.span_deg:.1f} deg, condition {found.condition:.1f}"),
    ]
