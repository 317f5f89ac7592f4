"""Implicit shapes of the heart and its neighbourhood at end-diastole.

Depths are approximate signed distances in mm, positive inside. Heart frame: apex of the left ventricle at the
origin, z towards the base, x towards the right ventricle, y towards the outflow tracts.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from data_synth.kernels.depths import ellipsoid_depths, tube_depths
from data_synth.kernels.lv import BASE, OUTER, POWER, STANDARD_CAVITY
from dvf_ig.core import FloatArray, read_only_arrays

from .reference import Layers
from .tissue import Tissue

BLEND_MM = 6.0
GROOVE_MM = 20.0
"""Blend between ventricles and atria, whose fat-filled groove is shallow."""
RIM_MM = 6.0
SKELETON_CENTER = np.array([0.0, 0.0, BASE + 3.0])
SKELETON_SEMI = np.array([28.0, 28.0, 12.0])
"""Fibrous skeleton and fat between the valve rings."""
LOBE = float(np.sqrt(3.0))
"""Size of the motion's lobes relative to the chambers: the divergence changes sign at the outer wall."""
RV_RATE = -0.46
LA_RATE = 0.2
RA_RATE = 0.18
"""Contraction or swelling at the middle of a chamber, per unit of activation."""
PULMONARY_VEINS = np.array([[-0.92, 0.3, 0.18], [-0.93, -0.3, 0.0], [0.1, -0.16, 0.94], [0.08, -0.76, 0.58]])
"""Left superior and inferior, right superior and inferior: directions from the left atrium."""
VENAE_CAVAE = np.array([[0.2, 0.83, 0.52], [-0.03, -0.85, -0.52]])
"""Superior and inferior: directions from the right atrium."""
MIN_WALL_MM = 2.0
FAT_MM = 2.5
PERICARDIUM_MM = 1.0


def ellipsoid_depth(p: FloatArray, center: FloatArray, semi: FloatArray) -> FloatArray:
    """Compute the first-order signed distance to an ellipsoid."""
    out = np.empty(len(p))
    ellipsoid_depths(p, center, semi, out)
    return out


def tube_depth(p: FloatArray, path: FloatArray, radii: FloatArray) -> FloatArray:
    """Compute the signed distance to a chain of round cones of interpolated radii along `path`."""
    out = np.empty(len(p))
    tube_depths(p, path, radii, out)
    return out


def bullet_depth(p: FloatArray, apex_z: float, radius: float, round_mm: float = 0.0) -> FloatArray:
    """Compute approximate depth inside R = radius √(1 − (1 − s)^2.2), s from `apex_z` to the base's cut.

    `round_mm` rounds the rim of the cut.
    """
    length = BASE - apex_z
    u = np.maximum(1.0 - (p[:, 2] - apex_z) / length, 0.0)
    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
    level = 1.0 - r2 / radius**2 - u**POWER
    slope = np.sqrt(4 * r2 / radius**4 + (POWER * u ** (POWER - 1) / length) ** 2)
    side = level / np.maximum(slope, 0.5 / radius)
    below = BASE - p[:, 2]
    return np.minimum(side, below) if round_mm == 0 else -smooth_union(-side, -below, round_mm)


def smooth_union(a: FloatArray, b: FloatArray, blend_mm: float = BLEND_MM) -> FloatArray:
    """Unite two depths with a C1 blend of compact support (polynomial smooth maximum)."""
    overlap = np.maximum(blend_mm - np.abs(a - b), 0.0) / blend_mm
    return np.asarray(np.maximum(a, b) + overlap**2 * blend_mm / 4)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HeartShape:
    """Sizes and positions of the left ventricle's cavity and of the parts around it, heart frame, mm.

    `lv_cavity` is the (6,) cavity of `kernels.lv`; the left ventricle's epicardium is the same in all hearts.
    """

    rv_center: FloatArray
    rv_semi: FloatArray
    la_center: FloatArray
    la_semi: FloatArray
    ra_center: FloatArray
    ra_semi: FloatArray
    laa_path: FloatArray
    laa_radii: FloatArray
    aorta_path: FloatArray
    pulmonary_path: FloatArray
    vein_paths: FloatArray
    cava_paths: FloatArray
    aorta_radius_mm: float = 14.5
    pulmonary_radius_mm: float = 13.0
    vein_radius_mm: float = 7.0
    cava_radius_mm: float = 10.5
    lv_cavity: FloatArray = field(default_factory=STANDARD_CAVITY.copy)
    papillary: FloatArray = field(
        default_factory=lambda: np.array(
            [[[-10.0, 15.5, 36.0], [-6.0, 8.0, 60.0]], [[-14.0, -13.0, 36.0], [-7.0, -7.0, 60.0]]]
        )
    )

    def organ(self, p: FloatArray) -> FloatArray:
        """Compute depth below the whole heart's epicardial surface, which is smooth and closed."""
        depth = smooth_union(self._lv(p), ellipsoid_depth(p, self.rv_center, self.rv_semi))
        depth = smooth_union(depth, ellipsoid_depth(p, SKELETON_CENTER, SKELETON_SEMI))
        depth = smooth_union(depth, ellipsoid_depth(p, self.la_center, self.la_semi), GROOVE_MM)
        depth = smooth_union(depth, ellipsoid_depth(p, self.ra_center, self.ra_semi), GROOVE_MM)
        depth = smooth_union(depth, tube_depth(p, self.laa_path, self.laa_radii))
        depth = smooth_union(depth, tube_depth(p, self.aorta_path, self._radii(self.aorta_radius_mm)))
        depth = smooth_union(depth, tube_depth(p, self.pulmonary_path, self._radii(self.pulmonary_radius_mm)))
        return smooth_union(depth, np.maximum(*self._veins(p)))

    def inside(self, p: FloatArray, organ: FloatArray) -> Layers:
        """List parts of the heart, painted in order over ATRIAL_WALL, without valves and papillaries."""
        lv = self._lv(p)
        rv = ellipsoid_depth(p, self.rv_center, self.rv_semi)
        aorta = tube_depth(p, self.aorta_path, self._radii(self.aorta_radius_mm))
        pulmonary = tube_depth(p, self.pulmonary_path, self._radii(self.pulmonary_radius_mm))
        below, above = BASE - p[:, 2], p[:, 2] - BASE
        lumen = organ - MIN_WALL_MM
        la = np.minimum(ellipsoid_depth(p, self.la_center, self.la_semi) - 2.5, np.minimum(above, lumen))
        ra = ellipsoid_depth(p, self.ra_center, self.ra_semi) - 2.5
        laa = np.minimum(tube_depth(p, self.laa_path, self.laa_radii) - 2.0, lumen)
        rv_cavity = np.minimum(np.minimum(rv - 4.0, -lv), np.minimum(below - 1.0, lumen - 1.5))
        septum = np.maximum(aorta, la + 2.0)
        veins, cavae = self._veins(p)
        return [
            (Tissue.RV_WALL, np.minimum(rv + BLEND_MM, below + 2.0)),
            (Tissue.VESSEL_WALL, np.minimum(np.maximum(aorta, pulmonary) + 1.0, above)),
            (Tissue.RA_BLOOD, np.minimum(np.minimum(cavae - 1.5, lumen + 0.5), -septum)),
            (Tissue.LA_BLOOD, np.maximum(la, np.minimum(veins - 1.5, lumen + 0.5))),
            (Tissue.LAA_BLOOD, np.minimum(laa, -la - 0.5)),
            (Tissue.RA_BLOOD, np.minimum(np.minimum(ra, above - 1.0), np.minimum(lumen, -septum))),
            (Tissue.LV_MYOCARDIUM, lv),
            (Tissue.RV_BLOOD, rv_cavity),
            (Tissue.VESSEL_WALL, np.minimum(aorta, above)),
            (Tissue.PULMONARY_ARTERY, np.minimum(pulmonary - 2.0, np.minimum(above - 1.0, lumen))),
            (Tissue.AORTA, np.minimum(aorta - 2.0, np.minimum(above - 1.0, lumen))),
            (Tissue.LV_BLOOD, self._lv_blood(p)),
        ]

    def inside_ultrasound_only(self, p: FloatArray) -> Layers:
        """List valve leaflets and papillary muscles, shown by ultrasound but not by pre-operative images."""
        papillary = np.full(len(p), -np.inf)
        for path in self.papillary:
            papillary = np.maximum(papillary, tube_depth(p, path, np.array([4.0, 2.5])))
        cavity = self._lv_blood(p)
        disc = 0.8 - np.abs(p[:, 2] - (BASE + 0.5))
        mitral = np.minimum(disc, ellipsoid_depth(p, self.la_center, self.la_semi) - 1.5)
        tricuspid = np.minimum(disc, ellipsoid_depth(p, self.ra_center, self.ra_semi) - 1.5)
        aortic = np.minimum(disc, tube_depth(p, self.aorta_path, self._radii(self.aorta_radius_mm)) - 1.0)
        return [
            (Tissue.PAPILLARY, np.minimum(papillary, cavity + 1.0)),
            (Tissue.VALVE, np.maximum(np.maximum(mitral, tricuspid), aortic)),
        ]

    def _veins(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute depths in the pulmonary veins and in the venae cavae."""
        veins, cavae = (
            np.max([tube_depth(p, path, np.full(2, radius)) for path in paths], axis=0)
            for paths, radius in (
                (self.vein_paths, self.vein_radius_mm),
                (self.cava_paths, self.cava_radius_mm),
            )
        )
        return veins, cavae

    def lobes(self) -> FloatArray:
        """Return (3, 7) lobes of the motion around the left ventricle, see `kernels.flow.velocity`."""
        parts = (
            (self.rv_center, self.rv_semi, RV_RATE),
            (self.la_center, self.la_semi, LA_RATE),
            (self.ra_center, self.ra_semi, RA_RATE),
        )
        return np.stack([[*center, *(1.0 / (LOBE * semi)), rate] for center, semi, rate in parts])

    def _lv(self, p: FloatArray) -> FloatArray:
        return bullet_depth(p, 0.0, OUTER, RIM_MM)

    def _lv_blood(self, p: FloatArray) -> FloatArray:
        return bullet_depth(p, self.lv_cavity[1], self.lv_cavity[0])

    def _radii(self, radius: float) -> FloatArray:
        return np.full(3, radius)


def heart_shape(rng: np.random.Generator) -> HeartShape:
    """Draw an adult heart whose right ventricle and atria vary by some mm; the left ventricle is fixed."""

    def near(*values: float, spread: float = 1.5) -> FloatArray:
        return np.array(values) + rng.uniform(-spread, spread, 3)

    laa = np.array([[-20.0, 10.0, 106.0], [-36.0, 24.0, 101.0], [-34.0, 41.0, 93.0]])
    aorta = np.array([[8.0, 12.0, 80.0], [10.0, 14.0, 112.0], [20.0, 12.0, 138.0]])
    pulmonary = np.array([[34.0, 26.0, 74.0], [20.0, 40.0, 104.0], [0.0, 44.0, 126.0]])
    rv_center, rv_semi = near(25.0, 2.0, 52.0), near(37.0, 36.0, 46.0)
    la_center, la_semi = near(-13.0, -12.0, 109.0), near(31.0, 26.0, 28.0)
    ra_center, ra_semi = near(40.0, -16.0, 106.0), near(26.0, 25.0, 27.0)
    return HeartShape(
        rv_center=rv_center,
        rv_semi=rv_semi,
        la_center=la_center,
        la_semi=la_semi,
        ra_center=ra_center,
        ra_semi=ra_semi,
        laa_path=laa + rng.uniform(-2, 2, 3),
        laa_radii=np.array([10.0, 9.0, 6.5]),
        aorta_path=aorta,
        pulmonary_path=pulmonary,
        vein_paths=_outward(la_center, PULMONARY_VEINS, 12.0, 40.0),
        cava_paths=_outward(ra_center, VENAE_CAVAE, 12.0, 40.0),
    )


def with_vessels(heart: HeartShape, turn: FloatArray) -> HeartShape:
    """Add pulmonary veins and venae cavae that leave the atria in directions turned by `turn`."""
    return replace(
        heart,
        vein_paths=_outward(heart.la_center, PULMONARY_VEINS @ turn.T, 12.0, 40.0),
        cava_paths=_outward(heart.ra_center, VENAE_CAVAE @ turn.T, 12.0, 40.0),
    )


def _outward(center: FloatArray, directions: FloatArray, start_mm: float, stop_mm: float) -> FloatArray:
    """Build (n, 2, 3) straight paths from a centre along directions."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(center + unit[:, None] * np.array([[start_mm], [stop_mm]]))


def outside_layers(relative_mm: FloatArray, organ: FloatArray) -> Layers:
    """List neighbours of the heart, painted over MEDIASTINUM.

    Acoustic windows: the whole anterior side (open chest) and a posterior gap between the lungs.

    Args:
        relative_mm: (n, 3) positions from the heart's centre along patient axes (LPS).
        organ: (n,) depth below the epicardium.
    """
    outside = -organ

    def lump(center: tuple[float, ...], semi: tuple[float, ...], gap_mm: float) -> FloatArray:
        depth = ellipsoid_depth(relative_mm, np.array(center), np.array(semi))
        return np.minimum(depth, outside - gap_mm)

    lung = np.maximum(
        lump((105.0, 45.0, 20.0), (60.0, 75.0, 120.0), 10.0),
        lump((-120.0, 40.0, 25.0), (65.0, 75.0, 120.0), 10.0),
    )
    liver = lump((-45.0, 15.0, -110.0), (95.0, 85.0, 55.0), 6.0)
    spine = 18.0 - np.hypot(relative_mm[:, 0], relative_mm[:, 1] - 105.0)
    fat = np.minimum(outside, FAT_MM - outside)
    pericardium = np.minimum(outside - FAT_MM, FAT_MM + PERICARDIUM_MM - outside)
    return [
        (Tissue.LUNG, lung),
        (Tissue.LIVER, liver),
        (Tissue.BONE, spine),
        (Tissue.FAT, fat),
        (Tissue.PERICARDIUM, pericardium),
    ]
