"""`dvf-ig calibrate pivot`: the tool tip from poses recorded while it rested in a divot."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, SeedOption, command

from .output import MaxResidualOption, OutputOption, judge, marked, save, show, vector, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import PivotResult


def pivot(
    poses: Annotated[Path, Argument(help="PLUS sequence, folder of 4x4 texts, or table x y z qx qy qz qw.")],
    tool: Annotated[str | None, Option(help="Frame of the tool in a sequence.")] = None,
    max_residual_mm: MaxResidualOption = None,
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Find the tool tip from poses recorded while it rested in a divot."""
    with command():
        import numpy as np

        from dvf_ig.calibration import PivotOptions, calibrate_pivot
        from dvf_ig.io import read_poses
        from dvf_ig.report import write_residual_picture

        options = PivotOptions()
        if max_residual_mm is not None:
            options = PivotOptions(max_rms_mm=max_residual_mm)
        recorded = read_poses(poses, source=tool)
        fit = calibrate_pivot(recorded, rng=np.random.default_rng(seed), options=options)
        result = {**_result(fit), "max_residual_mm": options.max_rms_mm}
        matrix = np.eye(4)
        matrix[:3, 3] = result["tip_mm"]
        name = f"{fit.tip.frame}_from_{fit.tip.frame}_tip"
        title = marked(
            result,
            f"Tool tip of '{fit.tip.frame}': {fit.rms_3d_mm:.2f} mm RMS over {int(fit.inliers.sum())} "
            f"of {fit.poses} poses that span {fit.span_deg:.0f}°",
        )
        save(
            output, result, name, matrix, fit.rms_3d_mm,
            lambda png: write_residual_picture(png, fit.residuals_mm, title=title, used=fit.inliers),
        )  # fmt: skip
        show(result, _rows(fit), as_json=as_json)
        judge(result)


def _result(fit: "PivotResult") -> dict[str, Any]:
    import numpy as np

    return {
        "kind": "tip",
        **verdict(fit.refusals),
        "tip_mm": fit.tip.xyz_mm[0].tolist(),
        "pivot_mm": fit.pivot.xyz_mm[0].tolist(),
        "rms_3d_mm": fit.rms_3d_mm,
        "rms_per_coordinate_mm": fit.rms_per_coordinate_mm,
        "inliers": int(fit.inliers.sum()),
        "poses": fit.poses,
        "span_deg": fit.span_deg,
        "condition": fit.condition,
        "tip_sd_mm": np.sqrt(np.diag(fit.covariance)[:3]).tolist(),
        "tip_frame": fit.tip.frame,
        "pivot_frame": fit.pivot.frame,
    }


def _rows(fit: "PivotResult") -> list[tuple[str, str]]:
    residual = f"{fit.rms_3d_mm:.3f} mm RMS (3-D), {fit.rms_per_coordinate_mm:.3f} per coordinate"
    return [
        ("tip", f"{vector(fit.tip.xyz_mm[0].tolist())} mm in '{fit.tip.frame}'"),
        ("pivot", f"{vector(fit.pivot.xyz_mm[0].tolist())} mm in '{fit.pivot.frame}'"),
        ("residual", residual),
        ("poses used", f"{int(fit.inliers.sum())} of {fit.poses}"),
        ("angular span", f"{fit.span_deg:.1f} deg, condition {fit.condition:.1f}"),
    ]
