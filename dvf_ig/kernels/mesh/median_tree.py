"""Median splits of triangles into a complete tree of bounding boxes."""

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.compiled import inlined, kernel


@inlined
def _longest_axis(centers: FloatArray, order: IntArray, first: int, last: int) -> int:
    """Find the axis along which the centres of a range of the order extend farthest."""
    longest, axis = -1.0, 0
    for a in range(3):
        low = high = centers[order[first], a]
        for i in range(first + 1, last):
            value = centers[order[i], a]
            low = value if value < low else low
            high = value if value > high else high
        if high - low > longest:
            longest, axis = high - low, a
    return axis


@inlined
def _select(keys: FloatArray, order: IntArray, first: int, last: int, middle: int) -> None:
    """Reorder both so that no key of [first, middle) exceeds one of [middle, last): Hoare 1961."""
    low, high = first, last - 1
    while low < high:
        pivot = keys[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                keys[i], keys[j] = keys[j], keys[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@kernel
def split_at_medians(centers: FloatArray, levels: int, order: IntArray, keys: FloatArray) -> None:
    """Order items so that each node of a complete tree holds a contiguous range, split by its children.

    Node k of the 2^l nodes of level l holds items k·t // 2^l to (k + 1)·t // 2^l; they are split at the
    median along the axis on which their centres extend farthest.

    Args:
        centers: (t, 3), finite.
        order: (t,) the items, reordered.
        keys: (t,) work space.
    """
    count = len(order)
    for level in range(levels):
        nodes = 1 << level
        for k in range(nodes):
            first, last = k * count // nodes, (k + 1) * count // nodes
            middle = (2 * k + 1) * count // (2 * nodes)
            if last - first < 2:
                continue
            axis = _longest_axis(centers, order, first, last)
            for i in range(first, last):
                keys[i] = centers[order[i], axis]
            _select(keys, order, first, last, middle)


@kernel
def fill_boxes(corners: FloatArray, leaf_start: IntArray, boxes: FloatArray) -> None:
    """Fill (2l − 1, 6) lower and upper corners of the nodes from (t, 9) triangle corners in leaf order."""
    leaves = len(leaf_start) - 1
    for leaf in range(leaves):
        node = leaves - 1 + leaf
        for a in range(3):
            low = high = corners[leaf_start[leaf], a]
            for t in range(leaf_start[leaf], leaf_start[leaf + 1]):
                for corner in range(3):
                    low = min(low, corners[t, 3 * corner + a])
                    high = max(high, corners[t, 3 * corner + a])
            boxes[node, a], boxes[node, 3 + a] = low, high
    for node in range(leaves - 2, -1, -1):
        for a in range(3):
            boxes[node, a] = min(boxes[2 * node + 1, a], boxes[2 * node + 2, a])
            boxes[node, 3 + a] = max(boxes[2 * node + 1, 3 + a], boxes[2 * node + 2, 3 + a])
