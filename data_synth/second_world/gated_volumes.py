"""Gated 3-D ultrasound and earlier MR of a heart of the second world."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.operator.hand import perpendicular
from data_synth.seeds import child_rng, child_seed
from data_synth.signals.tracker import PosePath
from data_synth.ultrasound.volume import MatrixProbe, shown_volume, simulate_pyramid
from dvf_ig.core import FloatArray, Landmarks, Preop, Rigid, TrackedVolume

from .changed_heart import ChangedHeart, changed_heart
from .cine import cine
from .drawn import Drawn
from .echo_images import drawn_display
from .floor import RigidFloor, floor_of
from .measured_poses import DistortedField, distorted_field
from .operating_room import constant_path, cycle_law, miscalibrated, true_pose
from .probes import insonified, sector_of
from .recording import SecondWorldSpec
from .resting_heart import RestingHeart, box_of, four_chamber_heart
from .sweeps import probe_place
from .tissue_fields import TissueFields, tissue_fields

VOLUME_VIEWS = ("epicardial", "tee")
"""Probes whose positions the matrix array takes, one after the other."""
BEATS_PER_VOLUME = 4
_VIEW_S = 8.0
"""Time from one view to the next, in which the tracker drifts."""
_ROW_S = 0.15
"""Time over whose rows drop-outs come and go."""
_FLOOR_POINTS = 3000


@dataclass(frozen=True, eq=False)
class SecondWorldPair:
    """Heart as imaged by MR and by a tracked matrix array.

    Attributes:
        heart, fields: the heart during the MR.
        changed, changed_rms_mm: the heart under the probe, and the distance of its surface from that of the
            MR.
        mr_from_tracker: true pose.
        drawn: every value of this heart.
    """

    heart: RestingHeart
    fields: TissueFields
    changed: ChangedHeart
    changed_rms_mm: float
    mr_from_tracker: Rigid
    drawn: Drawn

    @cached_property
    def preop(self) -> Preop:
        return cine(self.heart, self.fields, cycle_law(self.heart, self.drawn), self.drawn)

    @property
    def targets(self) -> Landmarks:
        """Points at which registration errors are stated, frame "mr"."""
        return self.heart.targets

    @property
    def center_mm(self) -> FloatArray:
        return np.asarray(self.heart.box_mm.mean(axis=0))

    @cached_property
    def array(self) -> MatrixProbe:
        """Matrix array with its nominal geometry; voxels outside its depth are not insonified."""
        lines = round(self.drawn["matrix.lines"])
        sector = sector_of("epicardial", self.drawn)
        sector = replace(sector, lines=lines, samples=8 * round(sector.depth_mm / 0.36 / 8), fine_lines=2)
        return MatrixProbe(sector, lines, self.drawn["matrix.voxel_mm"])

    @cached_property
    def views(self) -> tuple[Rigid, ...]:
        """True mr_from_plane of each view."""
        return tuple(self._view(kind) for kind in VOLUME_VIEWS)

    @cached_property
    def field(self) -> DistortedField:
        """Tracker's distorted field."""
        tracker_from_mr = self.mr_from_tracker.inverse()
        places = np.stack([view.translation_mm for view in self.views])
        return distorted_field(
            box_of(tracker_from_mr.apply_array(np.concatenate([places, self.heart.ed_vertices_mm]))),
            self.drawn,
        )

    def volumes(self, phases: Sequence[float]) -> tuple[TrackedVolume, ...]:
        """Simulate gated 3-D images, every phase of one view before the next.

        Args:
            phases: model phases that gating aims at, as they are recorded.
        """
        rng = child_rng(self.drawn.seed, "second world volume gates")
        seed = child_seed(self.drawn.seed, "second world volume speckle")
        array, count = self.array, len(phases)
        true_array = replace(array, sector=insonified(array.sector, self.drawn["image.sound_speed"]))
        out = []
        for v, view in enumerate(self.views):
            for k, phase in enumerate(phases):
                late = (
                    self.drawn["rhythm.gate_noise_s"]
                    / self.heart.rr_s
                    * rng.standard_normal(BEATS_PER_VOLUME)
                )
                beat = np.arange(array.tall) * BEATS_PER_VOLUME // array.tall
                times = np.repeat((phase + late[beat])[:, None], array.sector.lines, axis=1)
                level = simulate_pyramid(
                    self.changed, true_array, view, times, seed=seed, frame=v * count + k
                )
                shown = shown_volume(self._displayed(level), array)
                pose = self.read_pose(v, _VIEW_S * v + k, rng)
                out.append(TrackedVolume(shown.image, shown.mask, pose, phase % 1.0))
        return tuple(out)

    def read_pose(self, view: int, t_s: float, rng: np.random.Generator | None) -> Rigid:
        """Read tracker_from_plane as tracked and calibrated, the mean of a reading a beat; None: no noise."""
        true: PosePath = constant_path(self.mr_from_tracker.inverse() @ self.views[view])
        rotations, places = self.field.read(true)(np.array([t_s]))
        read = Rigid("tracker", "plane", rotations[0], places[0])
        error = miscalibrated(Rigid.identity("plane", "plane"), self.array.sector.depth_mm, self.drawn)
        if rng is not None:
            share = 1.0 / np.sqrt(3.0 * BEATS_PER_VOLUME)
            turn = np.deg2rad(self.drawn["tracker.rotation_deg"]) * share * rng.standard_normal(3)
            shift = self.drawn["tracker.position_mm"] * share * rng.standard_normal(3)
            turned = read.rotation @ Rotation.from_rotvec(turn).as_matrix()
            read = Rigid("tracker", "plane", turned, read.translation_mm + shift)
        return read @ error

    @cached_property
    def floor(self) -> RigidFloor:
        """Compute the error that no rigid registration of the volumes can remove, at ED and ES."""
        rng = child_rng(self.drawn.seed, "second world volume floor")
        sector, before = self.array.sector, self.heart.resting_motion
        seen, meant = [], []
        for v, view in enumerate(self.views):
            side = np.tan(sector.half_angle_rad) * rng.uniform(-1, 1, (_FLOOR_POINTS, 2))
            rays = np.column_stack([side[:, 0], np.ones(_FLOOR_POINTS), side[:, 1]])
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            shown = rays * sector.depth_mm * np.cbrt(rng.uniform(0, 1, (_FLOOR_POINTS, 1)))
            true = view.apply_array(shown * (1.0 + self.drawn["image.sound_speed"]))
            phase = np.where(np.arange(_FLOOR_POINTS) % 2, self.heart.es_fraction, 0.0)
            material = self.changed.inverse_motion.pull_back(true, phase)
            in_heart = self.heart.shapes.organ(material) > 0
            seen.append(self.read_pose(v, _VIEW_S * v, None).apply_array(shown[in_heart]))
            meant.append(before.push_forward(material[in_heart], phase[in_heart]))
        together = (np.concatenate(seen), np.concatenate(meant))
        return floor_of(*together, self.targets, self.mr_from_tracker, self.changed_rms_mm)

    def _view(self, kind: str) -> Rigid:
        eye, aim = probe_place(kind, self.heart, self.fields.reference, self.drawn)
        beam = (aim - eye) / np.linalg.norm(aim - eye)
        rng = child_rng(self.drawn.seed, f"second world volume roll {kind}")
        lateral = perpendicular(beam, rng.standard_normal(3))
        return Rigid("mr", "plane", np.column_stack([lateral, beam, np.cross(lateral, beam)]), eye)

    def _displayed(self, level_db: np.ndarray) -> np.ndarray:
        """Convert levels to the dB that a straight log curve shows as this scanner's grey levels."""
        sector = self.array.sector
        display = drawn_display(sector, self.drawn)
        grey = np.stack([display.grey(row, _ROW_S * i) for i, row in enumerate(level_db)])
        floor_db = sector.top_db - sector.dynamic_range_db
        return np.asarray(floor_db + grey * (sector.dynamic_range_db / 255.0), dtype=np.float32)


def second_world_pair(spec: SecondWorldSpec) -> SecondWorldPair:
    """Build the heart before and now, and the tracker's pose; of `spec` seed, quality and motion count."""
    drawn = Drawn(spec.seed, spec.quality)
    resting = four_chamber_heart(spec.motion, spec.seed, spec.heart)
    fields = tissue_fields(resting, drawn)
    changed, rms_mm = changed_heart(resting, fields.reference, drawn)
    return SecondWorldPair(resting, fields, changed, rms_mm, true_pose(resting, drawn), drawn)
