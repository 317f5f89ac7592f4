"""A made-up brain: labels, MR per label, and ultrasound by physics that registration knows nothing of."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from dvf_ig.core import AnyArray, FloatArray, Grid, Points, Rigid, Volume

OUTSIDE, WHITE, GREY, VENTRICLE, SULCUS, TUMOUR = range(6)
MR_LEVEL = np.array([8.0, 110.0, 80.0, 25.0, 35.0, 140.0])
ECHO_DB = np.array([-14.0, -9.0, -11.0, -34.0, 4.0, 0.0])
IMPEDANCE = np.array([1.55, 1.60, 1.59, 1.52, 1.66, 1.64])
ATTENUATION_DB_PER_MM = np.array([0.03, 0.06, 0.06, 0.005, 0.12, 0.08])
FOV_DEG, DEPTH_MM = 38.0, 95.0


@dataclass(frozen=True, slots=True)
class Brain:
    """Implicit anatomy, frame "moving", centre at `center_mm`; 125 mm wide at a scale of 1."""

    seed: int
    scale: float = 1.0

    @property
    def center_mm(self) -> FloatArray:
        return np.array([14.0, -32.0, 51.0])

    def shifted_labels(self, xyz_mm: FloatArray, shift_mm: float) -> AnyArray:
        """The same after a smooth shift of `shift_mm` RMS, as an opened skull causes."""
        rng = np.random.default_rng(self.seed + 3000)
        field = np.stack([_waves(xyz_mm, rng, 100.0 * self.scale) for _ in range(3)], axis=-1)
        return self.labels(xyz_mm + shift_mm / np.sqrt(3.0) * field)

    def labels(self, xyz_mm: FloatArray) -> AnyArray:
        """(...) uint8 at (..., 3) mm."""
        rng = np.random.default_rng(self.seed)
        p = (xyz_mm - self.center_mm) / self.scale
        outer = np.linalg.norm(p / (62.0, 76.0, 54.0), axis=-1)
        depth = (1.0 - outer) * 58.0
        fold = _waves(p, rng, 30.0)
        deep = 17.0 + 5.0 * _waves(p, rng, 40.0)
        sheet = np.abs(fold) / 0.115
        out = np.where(depth < 3.0, GREY, WHITE).astype(np.uint8)
        out[(sheet < 4.0) & (depth < deep + 2.5)] = GREY
        out[(sheet < 1.0) & (depth < deep)] = SULCUS
        middle = 5.0 * _waves(p, rng, 90.0)
        out[(np.abs(p[..., 0] - middle) < 1.2) & (depth < 30.0) & (p[..., 2] > 0)] = SULCUS
        for side in (-1.0, 1.0):
            out[_tube(p, rng, side)] = VENTRICLE
        place = np.array([rng.choice([-1.0, 1.0]) * 28.0, rng.uniform(-30, 30), rng.uniform(2, 24)])
        radius = rng.uniform(9, 14) * (1 + 0.25 * _waves(p, rng, 22.0))
        out[np.linalg.norm((p - place) / rng.uniform(0.8, 1.3, 3), axis=-1) < radius] = TUMOUR
        out[depth < 0] = OUTSIDE
        return out


def _waves(p: FloatArray, rng: np.random.Generator, wavelength: float) -> FloatArray:
    """Smooth random field of about unit amplitude."""
    out = np.zeros(p.shape[:-1])
    for _ in range(6):
        k = rng.normal(size=3)
        k *= 2 * np.pi / (wavelength * rng.uniform(0.8, 1.3)) / np.linalg.norm(k)
        out += np.sin(p @ k + rng.uniform(0, 2 * np.pi))
    return np.asarray(out / np.sqrt(3.0))  # six sines have a variance of 3


def _tube(p: FloatArray, rng: np.random.Generator, side: float) -> AnyArray:
    """A lateral ventricle: a bent tube from front to back."""
    x0, bend, width = side * rng.uniform(9, 14), side * rng.uniform(0.004, 0.01), rng.uniform(5, 8)
    z0, arch, half = rng.uniform(4, 12), rng.uniform(0.006, 0.012), rng.uniform(28, 38)
    y = p[..., 1] - rng.uniform(-6, 6)
    away = np.hypot(p[..., 0] - x0 - bend * y**2, (p[..., 2] - z0 + arch * y**2) / 1.3)
    return np.asarray(away < width * np.sqrt(np.clip(1 - (y / half) ** 2, 0, 1)))


def brain_mr(brain: Brain, *, turn_deg: tuple[float, float, float] = (12.0, -8.0, 20.0)) -> Volume:
    """T1-like MR: oblique grid of 1.0 x 1.0 x 1.3 mm, coil shading, point spread and Rician noise."""
    rng = np.random.default_rng(brain.seed + 5000)
    direction = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    spacing = np.array([1.0, 1.0, 1.3])
    shape = tuple(int(n) for n in np.ceil(brain.scale * np.array([146.0, 172.0, 128.0]) / spacing))
    origin = brain.center_mm - direction @ (spacing * (np.array(shape) - 1) / 2)
    grid = Grid("moving", (shape[0], shape[1], shape[2]), origin, spacing, direction)
    xyz = grid.centers_mm()
    level = MR_LEVEL[brain.labels(xyz)] * (1 + 0.15 * _waves(xyz, rng, 300.0))
    level = ndimage.gaussian_filter(level, 0.6 / spacing)
    noisy = np.hypot(level + rng.normal(0, 5, shape), rng.normal(0, 5, shape))
    return Volume(grid, np.rint(noisy).astype(np.int16))


def true_pose() -> Rigid:
    """moving_from_fixed: the scanner's world is not the ultrasound's."""
    return Rigid.from_rotation_vector([0.5, -0.3, 0.9], [35.0, -60.0, 20.0], "moving", "fixed")


def brain_probe(brain: Brain) -> Rigid:
    """moving_from_probe: on the brain's surface, looking (+z of the probe) at its middle."""
    rng = np.random.default_rng(brain.seed + 7000)
    up = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4), 1.0])
    up /= np.linalg.norm(up)
    side = np.cross([0.0, 1.0, 0.0], -up)
    side /= np.linalg.norm(side)
    turn = np.column_stack([side, np.cross(-up, side), -up])
    reach = brain.scale / np.linalg.norm(up / (62.0, 76.0, 54.0))
    return Rigid("moving", "probe", turn, brain.center_mm + (reach + 4.0) * up)


def brain_ultrasound(brain: Brain, moving_from_fixed: Rigid, *, shift_mm: float = 1.0) -> Volume:
    """Log-compressed 3-D ultrasound, 0 outside the pyramid: Rayleigh speckle, facing borders, shadows."""
    rng = np.random.default_rng(brain.seed + 9000)
    lines, step = 90, 0.4
    angle = np.radians(np.linspace(-FOV_DEG, FOV_DEG, lines))
    r = np.arange(step, brain.scale * DEPTH_MM, step)
    a, b, rr = np.meshgrid(np.tan(angle), np.tan(angle), r, indexing="ij")
    unit = np.stack([a, b, np.ones_like(a)], axis=-1)
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    codes = brain.shifted_labels(brain_probe(brain).apply_array(unit * rr[..., None]), shift_mm)
    speckle = rng.normal(size=codes.shape) + 1j * rng.normal(size=codes.shape)
    echo = 10 ** (ECHO_DB[codes] / 20) * speckle
    border = np.abs(np.gradient(np.log(IMPEDANCE[codes]), axis=-1)) * 80.0
    echo = ndimage.gaussian_filter(
        echo + border * np.exp(2j * np.pi * rng.random(codes.shape)), (0.9, 0.9, 1)
    )
    loss_db = 2 * np.cumsum(ATTENUATION_DB_PER_MM[codes] * step, axis=-1) - 0.11 * rr
    level = 20 * np.log10(np.abs(echo) * 10 ** (-loss_db / 20) + 1e-3)
    top = np.percentile(level, 99.7)
    grey = np.clip((level - top + 55.0) / 55.0, 0.0, 1.0) * 255.0
    return _converted(grey, brain, moving_from_fixed, angle, step)


def _converted(
    grey: FloatArray, brain: Brain, moving_from_fixed: Rigid, angle: FloatArray, step: float
) -> Volume:
    """Lines to 1 mm voxels on a grid aligned with the probe, which is oblique in the fixed frame."""
    pitch_mm = 1.0
    fixed_from_probe = moving_from_fixed.inverse() @ brain_probe(brain)
    deep = brain.scale * DEPTH_MM
    half = deep * np.sin(angle[-1])
    shape = (int(2 * half / pitch_mm) + 1, int(2 * half / pitch_mm) + 1, int(deep / pitch_mm) + 1)
    corner = fixed_from_probe.apply_array(np.array([-half, -half, 0.0]))
    grid = Grid("fixed", shape, corner, np.full(3, pitch_mm), fixed_from_probe.rotation)
    x, y, z = (pitch_mm * np.arange(n) for n in shape)
    px, py, pz = np.meshgrid(x - half, y - half, z, indexing="ij")
    depth = np.sqrt(px**2 + py**2 + pz**2)
    pitch = angle[1] - angle[0]
    at = [
        (np.arctan2(px, pz) - angle[0]) / pitch,
        (np.arctan2(py, pz) - angle[0]) / pitch,
        depth / step - 1,
    ]
    image = ndimage.map_coordinates(grey, at, order=1, mode="constant", cval=0.0)
    seen = (at[0] >= 0) & (at[0] <= 89) & (at[1] >= 0) & (at[1] <= 89) & (depth < deep) & (depth > 4.0)
    return Volume(grid, np.where(seen, np.rint(image), 0).astype(np.uint8))


def targets(ultrasound: Volume, moving_from_fixed: Rigid) -> Points:
    """27 points over the inner two thirds of what was insonified, frame "moving"."""
    index = np.argwhere(ultrasound.values > 0)
    low, high = np.percentile(index, 10, axis=0), np.percentile(index, 90, axis=0)
    ticks = [np.linspace(low[k], high[k], 3) for k in range(3)]
    grid = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    return Points("moving", moving_from_fixed.apply_array(ultrasound.grid.to_mm(grid)))


def displaced(truth: Rigid, at: Points, mm: float, seed: int) -> Rigid:
    """A start whose mean error at the targets is `mm`, of random direction and share of rotation."""
    rng = np.random.default_rng(seed)
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    center = at.xyz_mm.mean(axis=0)
    fixed_mm = truth.inverse().apply_array(at.xyz_mm)
    share = rng.uniform(0.2, 0.8)
    turn *= share / 30.0 / np.linalg.norm(turn)
    shift *= (1 - share) / np.linalg.norm(shift)
    size = mm
    for _ in range(4):
        start = truth.perturbed_left(size * turn, size * shift, center)
        size *= mm / float(np.linalg.norm(start.apply_array(fixed_mm) - at.xyz_mm, axis=1).mean())
    return truth.perturbed_left(size * turn, size * shift, center)
