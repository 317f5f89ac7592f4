"""`dvf-ig calibrate hand-eye`: pose of a camera on the robot or the hand that holds it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, SeedOption, command

from .output import OutputOption, judge, marked, save, show, vector, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import HandEyeResult
    from dvf_ig.core import PoseStream


def hand_eye(
    robot: Annotated[Path, Argument(help="Poses of the hand in its base: sequence, folder or table.")],
    camera: Annotated[
        Path, Argument(help="Poses of a fixed target as the camera sees it, in the same forms.")
    ],
    hand: Annotated[str | None, Option(help="Frame of the hand in a sequence.")] = None,
    target: Annotated[str | None, Option(help="Frame of the target in a sequence.")] = None,
    method: Annotated[
        str, Option(help="Start: tsai, park, horaud, andreff, daniilidis, shah or li.")
    ] = "park",
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Find the pose of a camera on the hand that holds it, from a fixed target."""
    with command():
        from typing import cast

        import numpy as np

        from dvf_ig.calibration import HandEyeMethod, calibrate_hand_eye
        from dvf_ig.report import write_residual_picture

        fit = calibrate_hand_eye(
            _poses(robot, "base", "hand", hand),
            _poses(camera, "camera", "target", target),
            rng=np.random.default_rng(seed),
            method=cast(HandEyeMethod, method),
        )
        result = _result(fit, method)
        fitted = fit.hand_from_camera
        title = marked(
            result,
            f"{fitted.name}: target seen to {fit.rms_mm:.2f} mm, {fit.rms_deg:.2f}° RMS by "
            f"{int(fit.inliers.sum())} of {len(fit.inliers)} pairs",
        )
        save(
            output, result, fitted.name, fitted.matrix, fit.rms_mm,
            lambda png: write_residual_picture(
                png, fit.residuals_mm, title=title, used=fit.inliers, x_label="pair of poses"
            ),
        )  # fmt: skip
        rows = [
            ("transform", fitted.name),
            ("camera", f"{vector(fitted.translation_mm.tolist())} mm in '{fitted.target}'"),
            ("standard error", f"{_errors(result)}"),
            ("residual", f"{fit.rms_mm:.3f} mm and {fit.rms_deg:.3f} deg RMS of the target's pose"),
            ("pairs used", f"{int(fit.inliers.sum())} of {len(fit.inliers)}"),
            ("angular span", f"{fit.span_deg:.1f} deg, spread of the axes {fit.axis_spread:.2f}"),
        ]
        show(result, rows, as_json=as_json)
        judge(result)


def _poses(path: Path, target: str, source: str, chosen: str | None) -> "PoseStream":
    """Read poses: from a sequence by the frames that it records, else with the names given here."""
    from dvf_ig.io import read_poses
    from dvf_ig.io.plus.poses import SEQUENCE_SUFFIXES

    if path.suffix.lower() in SEQUENCE_SUFFIXES:
        return read_poses(path, source=chosen)
    return read_poses(path, target, chosen or source)


def _result(fit: "HandEyeResult", method: str) -> dict[str, Any]:
    import numpy as np

    fitted, errors = fit.hand_from_camera, np.sqrt(np.diag(fit.covariance))
    return {
        "kind": "hand-eye",
        **verdict(fit.refusals),
        "hand_from_camera": fitted.matrix.tolist(),
        "base_from_target": fit.base_from_target.matrix.tolist(),
        "rms_mm": fit.rms_mm,
        "rms_deg": fit.rms_deg,
        "residuals_mm": fit.residuals_mm.tolist(),
        "residuals_deg": fit.residuals_deg.tolist(),
        "inliers": int(fit.inliers.sum()),
        "pairs": len(fit.inliers),
        "span_deg": fit.span_deg,
        "axis_spread": fit.axis_spread,
        "rotation_sd_deg": np.degrees(errors[:3]).tolist(),
        "translation_sd_mm": errors[3:].tolist(),
        "covariance": fit.covariance.tolist(),
        "method": method,
        "target": fitted.target,
        "source": fitted.source,
    }


def _errors(result: dict[str, Any]) -> str:
    return f"{vector(result['translation_sd_mm'])} mm, {vector(result['rotation_sd_deg'])} deg"
