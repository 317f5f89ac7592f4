"""Pair of gated 3-D ultrasound of a heart and its earlier MR, whose registration is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.heart_spec import STANDARD_HEART, HeartSpec
from data_synth.heart.motion import MotionPreset
from data_synth.mr.cine import cine_preop
from data_synth.seeds import child_rng, child_seed
from data_synth.ultrasound.image_faults import degraded_pyramid
from data_synth.ultrasound.views import standard_view
from data_synth.ultrasound.volume import MatrixProbe, shown_volume, simulate_pyramid
from dvf_ig.core import FloatArray, InvalidInputError, Landmarks, Preop, Rigid, TrackedVolume

from .presets import PRESETS

Quality = Literal["no-mismatch", "calm", "poor-image"]
Change = Literal["none", "deformation", "motion"]

VOLUME_VIEWS = ("apical four-chamber", "epicardial short-axis")
"""Views in which the matrix array is held."""
BEATS_PER_VOLUME = 4
"""Parts of which a gated 3-D image is stitched, one a heart beat, each with one reading of its pose."""
PART_SHARE = 0.025
"""Share of the cycle that the recording of one part takes."""
DEFORMATION_MM = 5.0


@dataclass(frozen=True, slots=True)
class Jitter:
    """Noise of a tracked pose: RMS 3-D position in mm, RMS angle in degrees (about the probe)."""

    position_mm: float
    rotation_deg: float


JITTER: dict[Quality, Jitter] = {
    "no-mismatch": Jitter(0.4, 0.3),
    "calm": Jitter(0.4, 0.3),
    "poor-image": Jitter(1.0, 0.7),
}


@dataclass(frozen=True, slots=True)
class PairSpec:
    """Specification of a pair; the same values give bit-identical images.

    Attributes:
        seed: seed of every random choice.
        motion: motion of the heart.
        quality: preset whose mismatch, image faults and tracking noise apply.
        change: change of the heart since the MR: none; a DEFORMATION_MM mismatch instead of the
            quality's; or the other motion.
        heart: kind of heart, and seeds that differ from `seed`.
    """

    seed: int
    motion: MotionPreset = "paper5mm"
    quality: Quality = "calm"
    change: Change = "none"
    heart: HeartSpec = STANDARD_HEART

    def __post_init__(self) -> None:
        if self.seed < 0 or self.quality not in JITTER:
            raise InvalidInputError(
                f"seed {self.seed}, quality '{self.quality}'; needed a non-negative seed and one of "
                f"{', '.join(JITTER)}"
            )


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Heart as imaged by MR and ultrasound.

    Attributes:
        spec: specification of the pair.
        before: the heart during the MR.
        now: the heart under the probe.
        mr_from_tracker: true pose.
    """

    spec: PairSpec
    before: PhantomAnatomy
    now: PhantomAnatomy
    mr_from_tracker: Rigid

    @cached_property
    def preop(self) -> Preop:
        return cine_preop(self.before, child_rng(self.spec.seed, "pair preop"))

    @property
    def targets(self) -> Landmarks:
        """Points at which registration errors are stated, frame "mr"."""
        return self.before.targets()

    @property
    def center_mm(self) -> FloatArray:
        return np.asarray(self.before.box_mm.mean(axis=0))

    def volumes(
        self,
        phases: Sequence[float],
        *,
        phase_error: float | Sequence[float] = 0.0,
        probe: MatrixProbe | None = None,
    ) -> tuple[TrackedVolume, ...]:
        """Simulate gated 3-D images of the views in VOLUME_VIEWS, every phase of one before the next.

        Args:
            phases: model phases that gating aims at, as they are recorded.
            phase_error: share of the cycle by which the images are taken later, for all or for each phase.
        """
        late = np.broadcast_to(np.asarray(phase_error, dtype=np.float64), len(phases))
        array = probe or MatrixProbe()
        faults = PRESETS["poor-image" if self.spec.quality == "poor-image" else "calm"].image
        array = replace(array, sector=replace(array.sector, dynamic_range_db=faults.dynamic_range_db))
        views = [standard_view(name, self.now.reference) for name in VOLUME_VIEWS]
        view_rng = child_rng(self.spec.seed, "pair view")
        poses = [_hand_held(view, view_rng) for view in views]
        rng = child_rng(self.spec.seed, "pair poses")
        seed = child_seed(self.spec.heart.seeds(self.spec.seed).speckle, "pair ultrasound")
        rows = array.tall // BEATS_PER_VOLUME
        within = PART_SHARE * ((np.arange(array.tall) % rows + 0.5) / rows - 0.5)
        out = []
        for i, (mr_from_plane, k) in enumerate(product(poses, range(len(phases)))):
            times = np.repeat((phases[k] + late[k] + within)[:, None], array.sector.lines, axis=1)
            level = simulate_pyramid(self.now, array, mr_from_plane, times, seed=seed, frame=i)
            fault_rng = child_rng(self.spec.seed, f"pair faults {i // len(phases)}")
            shown = shown_volume(degraded_pyramid(level, array, faults, fault_rng), array)
            pose = self._read(mr_from_plane, rng, "plane", BEATS_PER_VOLUME)
            out.append(TrackedVolume(shown.image, shown.mask, pose, phases[k] % 1.0))
        return tuple(out)

    def _read(self, mr_from_plane: Rigid, rng: np.random.Generator, frame: str, readings: int = 1) -> Rigid:
        """Average readings of a probe's pose; `frame` is the probe's."""
        jitter = JITTER[self.spec.quality]
        true = self.mr_from_tracker.inverse() @ mr_from_plane
        per_axis = np.sqrt(3.0 * readings)
        turn = np.deg2rad(jitter.rotation_deg) * rng.standard_normal(3) / per_axis
        shift = jitter.position_mm * rng.standard_normal(3) / per_axis
        rotation = true.rotation @ Rotation.from_rotvec(turn).as_matrix()
        return Rigid("tracker", frame, rotation, true.translation_mm + shift)


def image_pair(spec: PairSpec) -> ImagePair:
    """Build the heart before and now, and the pose of the tracker."""
    mismatch = {"no-mismatch": 0.0, "calm": PRESETS["calm"].mismatch_mm}.get(
        spec.quality, PRESETS["poor-image"].mismatch_mm
    )
    before = phantom_anatomy(motion=spec.motion, mismatch_mm=0.0, seed=spec.seed, heart=spec.heart)
    motion: MotionPreset = spec.motion
    if spec.change == "motion":
        motion = "physiological" if spec.motion == "paper5mm" else "paper5mm"
    if spec.change == "deformation":
        mismatch = DEFORMATION_MM
    now = phantom_anatomy(motion=motion, mismatch_mm=mismatch, seed=spec.seed, heart=spec.heart)
    rng = child_rng(spec.seed, "pair tracker")
    rotation = Rotation.random(rng=rng).as_matrix()
    truth = Rigid("mr", "tracker", rotation, rng.uniform(-200.0, 200.0, 3))
    return ImagePair(spec, before, now, truth)


def _hand_held(view: Rigid, rng: np.random.Generator) -> Rigid:
    """Draw an operator's actual view: up to 12° and 6 mm from the textbook's."""
    turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(-12.0, 12.0, 3))).as_matrix()
    return Rigid("mr", "plane", view.rotation @ turn, view.translation_mm + rng.uniform(-6.0, 6.0, 3))
