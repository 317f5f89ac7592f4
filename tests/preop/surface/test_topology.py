"""Edges of a triangle surface, counted."""

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.preop.surface.topology import count_edges


@given(seed=st.integers(0, 2**32 - 1))
def test_the_census_counts_what_a_dictionary_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = np.stack([rng.permutation(6)[:3] for _ in range(rng.integers(1, 12))])
    directed = [(int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3)]
    uses = Counter((min(e), max(e)) for e in directed)
    ways = Counter(directed)
    census = count_edges(triangles)
    assert census.open_edges == sum(n == 1 for n in uses.values())
    assert census.non_manifold_edges == sum(n > 2 for n in uses.values())
    assert census.inconsistent_edges == sum(n == 2 and ways[e] != 1 for e, n in uses.items())
