"""Distinct rows by one key: as NumPy's own along an axis, order included."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.registration.shape.blocks import distinct_rows


@given(st.lists(st.tuples(*[st.integers(-9, 9)] * 4), min_size=1, max_size=40))
def test_distinct_rows_are_those_of_numpy(rows):
    given_rows = np.array(rows, dtype=np.int64)
    keys, part = np.unique(given_rows, axis=0, return_inverse=True)
    found, number = distinct_rows(given_rows)
    np.testing.assert_array_equal(found, keys)
    np.testing.assert_array_equal(number, part.ravel())
