"""Values own their arrays: nobody can change one after construction; every value with arrays keeps to it."""

import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re
from collections.abc import Callable
from typing import get_origin

import numpy as np
import pytest

import data_synth
import dvf_ig
from dvf_ig.core import FloatArray, Points, read_only_arrays


@read_only_arrays
@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Value:
    one: FloatArray
    several: tuple[FloatArray, ...] = ()
    named: dict[str, FloatArray] = dataclasses.field(default_factory=dict)


@read_only_arrays
@dataclasses.dataclass(frozen=True, eq=False)
class Nested:
    pairs: tuple[tuple[float, FloatArray], ...]
    named: dict[str, tuple[FloatArray, ...]]


def test_arrays_are_copied_once_and_cannot_be_written() -> None:
    given = np.zeros(3)
    value = Value(given, (given,), {"a": given})
    given[0] = 1.0
    for array in (value.one, value.several[0], value.named["a"]):
        assert array[0] == 0.0
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0
    assert dataclasses.replace(value, named={}).one is value.one


def test_views_of_writable_arrays_and_nested_ones_are_owned_too() -> None:
    given = np.zeros(4)
    view = given[1:3]
    view.setflags(write=False)
    value = Value(view, named={"a": given})
    nested = Nested(((0.5, given),), {"pairs": (given, given)})
    given[:] = 1.0
    assert value.one.tolist() == [0.0, 0.0]
    assert nested.pairs[0][1].tolist() == [0.0] * 4
    assert nested.named["pairs"][1].tolist() == [0.0] * 4


def test_values_without_slots_are_protected_after_unpickling() -> None:
    back = pickle.loads(pickle.dumps(Nested(((0.5, np.zeros(2)),), {})))
    assert not back.pairs[0][1].flags.writeable


def test_layout_is_kept_so_that_sums_keep_their_order() -> None:
    given = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    assert Value(given).one.flags.f_contiguous


def test_pickled_values_come_back_read_only() -> None:
    back = pickle.loads(pickle.dumps(Points("mr", np.zeros((2, 3)))))
    assert not back.xyz_mm.flags.writeable


def test_every_frozen_value_with_arrays_owns_them() -> None:
    missing = []
    for package in (dvf_ig, data_synth):
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if found.name.endswith("__main__"):
                continue
            module = importlib.import_module(found.name)
            for name, cls in inspect.getmembers(module, inspect.isclass):
                if cls.__module__ != found.name or not dataclasses.is_dataclass(cls):
                    continue
                holds = any(
                    re.search("ndarray", str(f.type)) and get_origin(f.type) is not Callable
                    for f in dataclasses.fields(cls)
                )
                frozen = vars(cls)["__dataclass_params__"].frozen
                protected = hasattr(cls.__init__, "__wrapped__")
                if holds and frozen and not protected:
                    missing.append(f"{found.name}.{name}")
    assert not missing
