"""elastix in a process of its own: `python -m …elastix_child PAIR.npz FOUND.json`. Imports itk.

itk brings its own copies of libraries that other packages load as well, and may end the process it is in.
"""

import importlib
import json
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

SETTINGS = {
    "Metric": ["AdvancedMattesMutualInformation"],
    "NumberOfHistogramBins": ["50"],
    "AutomaticTransformInitialization": ["false"],
    "AutomaticScalesEstimation": ["true"],
    "NumberOfResolutions": ["3"],
    "MaximumNumberOfIterations": ["500"],
    "NumberOfSpatialSamples": ["5000"],
    "ImageSampler": ["RandomCoordinate"],
    "NewSamplesEveryIteration": ["true"],
    "RandomSeed": ["1"],
    "WriteResultImage": ["false"],
    "ErodeMask": ["false"],
}
"""What differs from elastix' own rigid map."""


def main(pair: Path, found: Path) -> None:
    """Register, from the identity, what `baselines.elastix` wrote; leave elastix' transform as JSON."""
    itk: Any = importlib.import_module("itk")
    with np.load(pair, allow_pickle=False) as given:
        data = {name: given[name] for name in given.files}
    began = perf_counter()
    parameters = itk.ParameterObject.New()
    settings = parameters.GetDefaultParameterMap("rigid", 3)
    for key, value in SETTINGS.items():
        settings[key] = value
    settings["CenterOfRotationPoint"] = [repr(float(c)) for c in data["center_mm"]]
    parameters.AddParameterMap(settings)
    fixed, moving = (_image(itk, data, name, name) for name in ("fixed", "moving"))
    method = itk.ElastixRegistrationMethod.New(fixed, moving)
    method.SetFixedMask(_image(itk, data, "mask", "fixed"))
    method.SetParameterObject(parameters)
    method.SetNumberOfThreads(1)
    method.SetLogToConsole(False)
    method.UpdateLargestPossibleRegion()
    result = method.GetTransformParameterObject().GetParameterMap(0)
    names = ("TransformParameters", "CenterOfRotationPoint", "ComputeZYX")
    out = {name: list(result[name]) for name in names}
    found.write_text(json.dumps({**out, "seconds": perf_counter() - began}), encoding="utf-8")


def _image(itk: Any, data: dict[str, Any], values: str, place: str) -> Any:
    image = itk.image_from_array(np.ascontiguousarray(data[values].T))
    image.SetOrigin(data[f"{place}_origin_mm"].tolist())
    image.SetSpacing(data[f"{place}_spacing_mm"].tolist())
    image.SetDirection(itk.matrix_from_array(np.ascontiguousarray(data[f"{place}_direction"])))
    return image


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
