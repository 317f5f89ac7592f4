"""The floor of one dynamic force: `floor.cpp`, compiled for this machine where there is a C++ compiler."""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, Rigid
from dvf_ig.guidance import Sigmoid

SOURCE = Path(__file__).with_name("floor.cpp")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-c")


class CppFloor:
    """The compiled floor, bound to a model with evenly spaced phases and a sigmoid at the surface."""

    def __init__(self, library: ctypes.CDLL, model: DvfModel, model_from_query: Rigid, law: Sigmoid) -> None:
        self._function = library.dynamic_forces
        self._arrays = (
            model.coefficients.copy(),
            np.array(model.coefficients.shape, dtype=np.int32),
            np.array(model.origin_mm),
            np.ascontiguousarray(model_from_query.matrix[:3]),
        )
        self._per_knot, self._law = 1.0 / float(model.knot_spacing_mm), law

    def forces(self, xyz_mm: FloatArray, phase: FloatArray) -> Callable[[int, int, FloatArray], None]:
        """A function of begin, end and (n, 4) output: forces (N) and distance (mm) at those points."""
        c, shape, origin, pose = (a.ctypes.data_as(ctypes.c_void_p) for a in self._arrays)
        xyz, phi = (np.ascontiguousarray(a) for a in (xyz_mm, phase))
        numbers = (ctypes.c_double(self._law.gamma_per_mm), ctypes.c_double(self._law.cap_n))
        data = (xyz.ctypes.data_as(ctypes.c_void_p), phi.ctypes.data_as(ctypes.c_void_p))
        per_knot, function = ctypes.c_double(self._per_knot), self._function

        def run(begin: int, end: int, out: FloatArray) -> None:
            place = out.ctypes.data_as(ctypes.c_void_p)
            span = (ctypes.c_long(begin), ctypes.c_long(end))
            function(c, shape, origin, per_knot, pose, *numbers, *data, *span, place)

        run.__dict__["kept"] = (xyz, phi, self)
        return run


def compiled_floor(model: DvfModel, model_from_query: Rigid, law: Sigmoid) -> CppFloor | None:
    """The floor, or None where there is no C++ compiler."""
    compiler = shutil.which(os.environ.get("CXX", "g++")) or shutil.which("c++")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        compiled, library = Path(folder) / "floor.o", Path(folder) / "floor.so"
        # linked without -ffast-math: gcc would make the whole process flush subnormal numbers to zero
        for step in (
            [compiler, *FLAGS, str(SOURCE), "-o", str(compiled)],
            [compiler, "-shared", str(compiled), "-o", str(library)],
        ):
            if subprocess.run(step, capture_output=True, check=False).returncode != 0:
                return None
        return CppFloor(ctypes.CDLL(str(library)), model, model_from_query, law)
