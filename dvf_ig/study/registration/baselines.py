"""Baselines: mutual-information registration by SimpleITK and by elastix. Imports SimpleITK.

Both get the fan as sampling mask, the organ's centre as centre of rotation, one thread and a fixed seed.
"""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, Grid, InvalidInputError, Rigid, Volume
from dvf_ig.core.space.rigid import nearest_rotation

SEED = 1
"""SimpleITK takes 0 as the wall clock."""


@dataclass(frozen=True, slots=True, eq=False)
class BaselineResult:
    """The result of a baseline on an image pair.

    Attributes:
        name: of the baseline.
        moving_from_fixed: its pose; None where it gave none.
        note: how it ended, or why there is no pose.
        seconds: wall clock, preparation of the images included.
    """

    name: str
    moving_from_fixed: Rigid | None
    note: str
    seconds: float


@dataclass(frozen=True, slots=True)
class MattesOptions:
    """Three levels, 50 bins, gradient descent in steps of one physical size.

    Nine settings were tried on seeds 101–102 of a made-up brain from 3 and 8 mm. Four, with all voxels
    of the fan and first steps of 0.3 to 0.5 mm, came within 2 mm from 3 mm and never from 8 mm; these are
    those of three levels. The five others, with steps of 1 mm and more, did worse.

    Attributes:
        bins: of the joint histogram.
        shrink, smoothing_mm: of each level, coarse to fine.
        sampling: share of the masked voxels that each level samples.
        step_mm: first step; it is halved where the gradient turns, until `least_step_mm`.
        iterations: most at each level.
    """

    bins: int = 50
    shrink: tuple[int, ...] = (3, 2, 1)
    smoothing_mm: tuple[float, ...] = (3.0, 2.0, 1.0)
    sampling: float = 1.0
    step_mm: float = 0.4
    least_step_mm: float = 0.003
    iterations: int = 200


def mattes(
    fixed: Volume,
    mask: Volume,
    moving: Volume,
    start: Rigid,
    center_mm: FloatArray,
    *,
    options: MattesOptions | None = None,
) -> BaselineResult:
    """SimpleITK's Mattes mutual information.

    Args:
        fixed: ultrasound; mask: on its grid, non-zero inside the fan.
        moving: MR or CT.
        start: moving_from_fixed.
        center_mm: (3,) the organ's centre, moving frame; the pose turns about it.
    Raises:
        InvalidInputError: a mask on another grid, or empty.
    """
    import SimpleITK

    _check_mask(fixed, mask)
    opts, began = options or MattesOptions(), perf_counter()
    with _one_thread():
        method = SimpleITK.ImageRegistrationMethod()
        method.SetNumberOfThreads(1)
        method.SetMetricAsMattesMutualInformation(opts.bins)
        method.SetMetricSamplingStrategy(method.RANDOM)
        method.SetMetricSamplingPercentage(opts.sampling, SEED)
        method.SetMetricFixedMask(_itk_image(mask.grid, (mask.values != 0).astype(np.uint8)))
        method.SetInterpolator(SimpleITK.sitkLinear)
        method.SetOptimizerAsRegularStepGradientDescent(
            opts.step_mm, opts.least_step_mm, opts.iterations, 0.5, 1e-8
        )
        method.SetOptimizerScalesFromPhysicalShift()
        method.SetShrinkFactorsPerLevel(opts.shrink)
        method.SetSmoothingSigmasPerLevel(opts.smoothing_mm)
        method.SmoothingSigmasAreSpecifiedInPhysicalUnitsOn()
        method.SetInitialTransform(_itk_rigid(start, center_mm), inPlace=False)
        images = (_itk_image(v.grid, v.values.astype(np.float32)) for v in (fixed, moving))
        try:
            found = method.Execute(*images)
        except RuntimeError as exc:
            reason = str(exc).strip().splitlines()[-1].strip()
            return BaselineResult("mattes", None, f"no pose: {reason}", perf_counter() - began)
        note = str(method.GetOptimizerStopConditionDescription())
    pose = _centre_free(found, start)
    return BaselineResult("mattes", pose, note, perf_counter() - began)


def elastix(
    fixed: Volume, mask: Volume, moving: Volume, start: Rigid, center_mm: FloatArray
) -> BaselineResult:
    """elastix' rigid parameter map, where the package itk-elastix is installed; else a result without a pose.

    It runs in a process of its own (see `elastix_child`); the seconds are those of the registration there.
    Arguments and errors as in `mattes`.
    """
    _check_mask(fixed, mask)
    if importlib.util.find_spec("itk") is None:
        return BaselineResult("elastix", None, "absent: the package itk-elastix is not installed", 0.0)
    began = perf_counter()
    with TemporaryDirectory() as folder:
        pair, found = Path(folder, "pair.npz"), Path(folder, "found.json")
        np.savez(pair, **_placed(fixed, mask, moving, start, center_mm))
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-m", f"{__package__}.elastix_child", str(pair), str(found)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0 or not found.is_file():
            said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            note = f"no pose: elastix ended with code {done.returncode}: {said}"
            return BaselineResult("elastix", None, note, perf_counter() - began)
        result = json.loads(found.read_text(encoding="utf-8"))
    step = _from_euler(result, start.source)
    return BaselineResult("elastix", start @ step, "done", float(result["seconds"]))


def _placed(
    fixed: Volume, mask: Volume, moving: Volume, start: Rigid, center_mm: FloatArray
) -> dict[str, Any]:
    """The pair, with the moving image put where the start says: elastix begins at the identity."""
    back = start.inverse()
    return {
        "fixed": fixed.values.astype(np.float32),
        "mask": (mask.values != 0).astype(np.uint8),
        "moving": moving.values.astype(np.float32),
        "center_mm": back.apply_array(center_mm),
        "fixed_origin_mm": fixed.grid.origin_mm,
        "fixed_spacing_mm": fixed.grid.spacing_mm,
        "fixed_direction": fixed.grid.direction,
        "moving_origin_mm": back.apply_array(moving.grid.origin_mm),
        "moving_spacing_mm": moving.grid.spacing_mm,
        "moving_direction": back.rotation @ moving.grid.direction,
    }


def _check_mask(fixed: Volume, mask: Volume) -> None:
    if mask.values.shape != fixed.values.shape or not (mask.values != 0).any():
        raise InvalidInputError(
            f"the mask has shape {mask.values.shape} with {int((mask.values != 0).sum())} voxels set, the "
            f"fixed image {fixed.values.shape}; needed one on the fixed image's grid that is not empty"
        )


@contextmanager
def _one_thread() -> Iterator[None]:
    import SimpleITK

    before = SimpleITK.ProcessObject.GetGlobalDefaultNumberOfThreads()
    SimpleITK.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    try:
        yield
    finally:
        SimpleITK.ProcessObject.SetGlobalDefaultNumberOfThreads(before)


def _itk_image(grid: Grid, values: AnyArray) -> Any:
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(values.T))
    image.SetOrigin(grid.origin_mm.tolist())
    image.SetSpacing(grid.spacing_mm.tolist())
    image.SetDirection(grid.direction.ravel().tolist())
    return image


def _itk_rigid(pose: Rigid, center_mm: FloatArray) -> Any:
    """fixed → moving about the centre, which ITK wants in the fixed frame."""
    import SimpleITK

    center = pose.inverse().apply_array(center_mm)
    transform = SimpleITK.VersorRigid3DTransform()
    transform.SetCenter(center.tolist())
    transform.SetMatrix(pose.rotation.ravel().tolist(), 1e-8)
    transform.SetTranslation((center_mm - center).tolist())
    return transform


def _centre_free(transform: Any, start: Rigid) -> Rigid:
    """The pose that an ITK transform performs, wherever its centre is."""
    origin = np.array(transform.TransformPoint((0.0, 0.0, 0.0)))
    corners = np.array([transform.TransformPoint(tuple(row)) for row in np.eye(3).tolist()])
    return Rigid(start.target, start.source, nearest_rotation((corners - origin).T), origin)


def _from_euler(result: Any, frame: str) -> Rigid:
    """elastix' EulerTransform: three angles and a translation about its centre."""
    import SimpleITK

    numbers = [float(v) for v in result["TransformParameters"]]
    transform = SimpleITK.Euler3DTransform()
    transform.SetComputeZYX(result["ComputeZYX"][0] == "true")
    transform.SetCenter([float(v) for v in result["CenterOfRotationPoint"]])
    transform.SetParameters(numbers)
    return _centre_free(transform, Rigid.identity(frame, frame))
