"""Any rigid pair of an ultrasound volume and MR or CT of one organ that does not beat.

The pitch follows the size of what was insonified, and whether the pose may be used is judged as `check`
says. Several images of the anatomy, MR contrasts as a rule, are channels of one LC2. The source is the
ultrasound, the target the anatomy: where a user calls them "fixed" and "moving", the result is
moving_from_fixed.
"""

from collections.abc import Callable, Sequence

import numpy as np

from dvf_ig.core import BoolArray, InvalidInputError, NoOverlapError, Rigid, Stop, Volume, untold
from dvf_ig.registration.evidence.checks import Evidence, Limits
from dvf_ig.registration.evidence.pair_evidence import PairEvidence
from dvf_ig.registration.images import RegistrationOptions
from dvf_ig.registration.lc2.lc2 import SliceThreads
from dvf_ig.registration.lc2.volume_lc2 import VolumeLc2, blocks_of
from dvf_ig.registration.result import RegistrationResult

from .check import gather_pair_evidence
from .images import FanVolume, channels_around, extent_mm, fan_volume, share_inside, usable_voxels
from .search import REACH_MM, place_of, search

FEW_PITCHES, MANY_PITCHES, MIDDLE_PITCH_MM = 60.0, 80.0, 1.6
"""The fine pitch is a 60th of the fan's longest edge; of large fans 1.6 mm or, if that is more, an 80th. On
tuning pairs 1001–1004 finer ones change the error by less than 0.1 mm."""
COARSE_PITCHES = (2.0, 1.4)
"""Pitches of the coarse levels, in those of the fine one. On hard pairs (tuning 1029, 1031) the first has its
best pose 6 to 13 mm from the truth, where the fine level has its own at 1 mm; the second finds fewer of the
other poses by which a wrong one is known."""
BLOCK = 3
"""Voxels along the edge of a block: patches are six pitches wide."""
MARGIN_MM = 25.0
"""Width of the anatomy that is kept around the fan at its start."""
MIN_START_OVERLAP, MIN_OVERLAP = 0.1, 0.35
"""Least share of the fan inside the anatomy, at the start and at the pose found."""
MAX_IMAGES = 4
"""Most contrasts of the anatomy that are fitted at once."""


def register_pair(
    ultrasound: Volume,
    anatomies: Sequence[Volume],
    start: Rigid,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    mask: Volume | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register an ultrasound volume to one or several MR or CT volumes of one patient in one frame.

    Args:
        ultrasound: zeros around the non-zero voxels count as not insonified, dark regions among them as dark.
        anatomies: intensities, on any grids.
        start: anatomy_from_ultrasound to start from.
        clock: seconds from any origin, for the result's `seconds`.
        mask: on the ultrasound's grid, non-zero where it may be used.
    Returns:
        the pose with its evidence; see `check` for what makes it unusable.
    Raises:
        InvalidInputError: no image or too many, an empty image, or a mask on another grid.
        NoOverlapError: the images do not overlap at the start.
    """
    began, report = clock(), progress or untold
    if not 1 <= len(anatomies) <= MAX_IMAGES:
        raise InvalidInputError(f"{len(anatomies)} moving images; needed 1 to {MAX_IMAGES}")
    usable = usable_voxels(ultrasound, mask)
    fine_mm = _fine_pitch_mm(ultrasound, usable)
    fans = [fan_volume(ultrasound, usable, pitches * fine_mm) for pitches in (*COARSE_PITCHES, 1.0)]
    _require_overlap(anatomies, fans[-1], start)
    place = place_of(fans[-1].points_mm(300), start)
    with SliceThreads() as threads:
        *coarse, fine = (_metric(fan, anatomies, start, threads) for fan in fans)
        report(0.15)
        best = search(coarse, fine, start, place, rng=rng, report_progress=lambda x: report(0.15 + 0.6 * x))
        moved_mm = place.apart_mm(start, best.pose)
        checks = gather_pair_evidence(
            coarse[0],
            fine,
            best,
            place,
            moved_mm=moved_mm,
            rng=rng,
            report_progress=lambda x: report(0.75 + 0.25 * x),
        )
        start_similarity = fine.score(start).similarity
    pair = checks.evidence
    overlap = share_inside(anatomies, fans[-1], best.pose)
    return RegistrationResult(
        target_from_source=best.pose,
        start=start,
        stop=stop_of(pair, overlap, moved_mm),
        success_probability=pair.success_probability,
        tre_bound_mm=None,
        statistics=None,
        outside="",
        covariance=checks.covariance,
        noise_covariance=checks.covariance,
        center_mm=place.center_mm,
        evidence=Evidence(pair.z_score, pair.halves_mm, None, pair=pair),
        similarity=best.similarity,
        start_similarity=start_similarity,
        overlap=overlap,
        second_best=float(pair.elsewhere[0]) if len(pair.elsewhere) else 0.0,
        moved_mm=moved_mm,
        evaluations=best.evaluations,
        seconds=clock() - began,
        slices=len(fine.centers_mm),
        options=RegistrationOptions(
            patch_mm=2 * BLOCK * fine_mm, bound_mm=REACH_MM, min_overlap=MIN_OVERLAP, limits=PAIR_LIMITS
        ),
    )


def _fine_pitch_mm(ultrasound: Volume, usable: BoolArray) -> float:
    edge_mm = extent_mm(ultrasound, usable)
    pitch_mm = min(edge_mm / FEW_PITCHES, max(MIDDLE_PITCH_MM, edge_mm / MANY_PITCHES))
    return max(float(ultrasound.grid.spacing_mm.min()), pitch_mm)


PAIR_LIMITS = Limits(z_score=0.0, split_half_mm=float("inf"))
"""A pair is judged by `PairEvidence` alone."""


def _metric(fan: FanVolume, anatomies: Sequence[Volume], start: Rigid, threads: SliceThreads) -> VolumeLc2:
    channels = channels_around(anatomies, fan, start, MARGIN_MM)
    return VolumeLc2(blocks_of(fan.values, fan.grid, BLOCK), channels, threads)


def stop_of(pair: PairEvidence, overlap: float, moved_mm: float) -> Stop:
    """How it ended; `overlap`: the share of the ultrasound inside the anatomy, `moved_mm`: from the start."""
    if overlap < MIN_OVERLAP:
        return Stop.LOW_OVERLAP
    if moved_mm > REACH_MM:
        return Stop.MOVED_TOO_FAR
    return pair.stop


def _require_overlap(anatomies: Sequence[Volume], fan: FanVolume, start: Rigid) -> None:
    share = share_inside(anatomies, fan, start)
    if share < MIN_START_OVERLAP:
        raise NoOverlapError(
            f"{100 * share:.0f} % of the ultrasound lies inside the moving image at the start pose, needed "
            f"{100 * MIN_START_OVERLAP:.0f} %; give a start with --init FILE.tfm (without one the images are "
            "taken to share one world frame)"
        )
