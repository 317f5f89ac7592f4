"""Signed distance to a closed triangle mesh on a grid, exact within a band."""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel


@kernel(nogil=True, error_model="numpy")
def squared_distance(px: float, py: float, pz: float, a: AnyArray, b: AnyArray, c: AnyArray) -> float:
    """Compute the squared distance from a point to triangle abc (Ericson, 5.1.5)."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = px - a[0], py - a[1], pz - a[2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    bpx, bpy, bpz = px - b[0], py - b[1], pz - b[2]
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    cpx, cpy, cpz = px - c[0], py - c[1], pz - c[2]
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        scale = 1.0 / (va + vb + vc)
        v, w = vb * scale, vc * scale
    dx, dy, dz = apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz
    return float(dx * dx + dy * dy + dz * dz)


@kernel(nogil=True, error_model="numpy")
def band_distance(
    vertices: AnyArray, triangles: AnyArray, origin: AnyArray, spacing: float, band: float, out: AnyArray
) -> None:
    """Compute squared distances to the mesh at nodes nearer than `band`; `out` starts at band²."""
    shape = out.shape
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        u, v, w = (a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0, (a[2] + b[2] + c[2]) / 3.0
        radius = 0.0  # of a sphere around the triangle, about its centroid
        for corner in (a, b, c):
            away = (corner[0] - u) ** 2 + (corner[1] - v) ** 2 + (corner[2] - w) ** 2
            radius = max(radius, np.sqrt(away))
        for k in range(3):
            near = min(a[k], b[k], c[k]) - band - origin[k]
            far = max(a[k], b[k], c[k]) + band - origin[k]
            low[k] = max(0, int(np.ceil(near / spacing)))
            high[k] = min(shape[k] - 1, int(np.floor(far / spacing)))
        for i in range(low[0], high[0] + 1):
            x = origin[0] + i * spacing
            for j in range(low[1], high[1] + 1):
                y = origin[1] + j * spacing
                for k in range(low[2], high[2] + 1):
                    z = origin[2] + k * spacing
                    reach = np.sqrt(out[i, j, k]) + radius
                    if (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2 > (1.0 + 1e-9) * reach**2:
                        continue  # the whole triangle is further away than the nearest so far
                    d = squared_distance(x, y, z, a, b, c)
                    if d < out[i, j, k]:
                        out[i, j, k] = d


@kernel(nogil=True, error_model="numpy")
def mark_crossings(
    vertices: AnyArray, triangles: AnyArray, origin: AnyArray, spacing: float, flips: AnyArray
) -> None:
    """Toggle `flips` (nx, ny, nz + 1) at the first node above each crossing of a z column with the mesh.

    Columns are shifted by an irrational share of a micrometre so that none passes through an edge.
    """
    ox, oy = origin[0] + 1e-6 * np.sqrt(2.0), origin[1] + 1e-6 * np.sqrt(3.0)
    nx, ny, nz = flips.shape[0], flips.shape[1], flips.shape[2] - 1
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        i0 = max(0, int(np.ceil((min(a[0], b[0], c[0]) - ox) / spacing)))
        i1 = min(nx - 1, int(np.floor((max(a[0], b[0], c[0]) - ox) / spacing)))
        j0 = max(0, int(np.ceil((min(a[1], b[1], c[1]) - oy) / spacing)))
        j1 = min(ny - 1, int(np.floor((max(a[1], b[1], c[1]) - oy) / spacing)))
        for i in range(i0, i1 + 1):
            x = ox + i * spacing
            for j in range(j0, j1 + 1):
                y = oy + j * spacing
                u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                k = int(np.ceil((z - origin[2]) / spacing))
                flips[i, j, min(max(k, 0), nz)] ^= True


@kernel(nogil=True, error_model="numpy")
def radial_field(
    nodes: AnyArray, centers: AnyArray, weights: AnyArray, affine: AnyArray, out: AnyArray
) -> None:
    """Compute Σ w |x − c| + affine part at (n, 3) nodes; weights (c, k), affine (4, k), out (n, k)."""
    width = weights.shape[1]
    for n in range(len(nodes)):
        x, y, z = nodes[n, 0], nodes[n, 1], nodes[n, 2]
        for k in range(width):
            out[n, k] = affine[0, k] + x * affine[1, k] + y * affine[2, k] + z * affine[3, k]
        for c in range(len(centers)):
            dx, dy, dz = x - centers[c, 0], y - centers[c, 1], z - centers[c, 2]
            r = np.float32(np.sqrt(dx * dx + dy * dy + dz * dz))
            for k in range(width):
                out[n, k] += r * weights[c, k]
