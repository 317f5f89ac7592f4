"""Rigid US/MR registration: many coarse starts, LC2 refinement, fusion with the boundary, and judgement.

1. candidates: many starts optimised on coarse slices, the best distinct ones kept;
2. refine: the candidates on fine slices, ranked by LC2; the best once more on what lies within the model;
3. fuse: from LC2's pose to that which blocks of LC2 and of the boundary agree on, when the heart may also
   have changed its shape;
4. judge: the optima of the boundary and of subsets of the slices, curvature, z-score against wrong poses,
   overlap.
"""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import Rigid, mean_displacement_mm, untold
from dvf_ig.registration.evidence.assessment import features_of, image_statistics, table_of
from dvf_ig.registration.lc2.lc2 import SliceThreads
from dvf_ig.registration.pose_chart import predicted_error_mm
from dvf_ig.registration.search import find_candidates, refine

from .data import RegistrationData, RegistrationOptions
from .fuse import fuse
from .judge import assessed, gather_evidence, second_best, stop_of
from .result import RegistrationResult


def register_rigid(
    data: RegistrationData,
    start: Rigid,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    options: RegistrationOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register slices to the phase-matched model from a coarse pose.

    Args:
        data: what is registered to what.
        start: target_from_source to start from.
        rng: draws the displaced starts and the wrong poses.
        clock: seconds from any origin, for the result's `seconds`; nothing else depends on it.
        progress: is told the share of the work that is done.
    Returns:
        the most likely pose, its evidence, and whether it may be used.
    """
    opts, report_progress = options or RegistrationOptions(), progress or untold
    began = clock()
    with SliceThreads() as threads:
        coarse = data.coarse.metric(opts, threads)
        candidates = find_candidates(
            data, coarse, start, rng=rng, options=opts, report_progress=lambda x: report_progress(0.4 * x)
        )
        report_progress(0.5)
        refined = refine(
            data,
            candidates,
            options=opts,
            threads=threads,
            report_progress=lambda x: report_progress(0.6 + 0.2 * x),
        )
        fused = fuse(data, refined, opts, threads)
        report_progress(0.95)
        evidence = gather_evidence(data, coarse, refined, fused, rng=rng)
        overlap = refined.whole.score(fused.pose).overlap
        moved_mm = mean_displacement_mm(start, fused.pose, data.center_mm)
        similarity = refined.inside.score(fused.pose).similarity
        statistics = image_statistics(
            data.coarse.slices,
            similarity=similarity,
            overlap=overlap,
            information=refined.inside.information,
        )
        stop, assessment = assessed(
            stop_of(refined, fused, evidence, moved_mm=moved_mm, overlap=overlap, options=opts),
            table_of(opts.kind),
            features_of(evidence, similarity, predicted_error_mm(fused.covariance)),
            statistics,
        )
        report_progress(1.0)
        return RegistrationResult(
            target_from_source=fused.pose,
            stop=stop,
            success_probability=assessment.success_probability,
            tre_bound_mm=assessment.tre_bound_mm,
            covariance=fused.covariance * assessment.covariance_scale,
            covariance_scale=assessment.covariance_scale,
            noise_covariance=fused.noise_covariance,
            center_mm=data.center_mm,
            evidence=evidence,
            statistics=statistics,
            outside=assessment.outside,
            similarity=similarity,
            start_similarity=refined.inside.score(start).similarity,
            overlap=overlap,
            second_best=second_best(data, refined, fused.pose),
            moved_mm=moved_mm,
            evaluations=candidates.evaluations + refined.evaluations,
            seconds=clock() - began,
            slices=len(data.fine.slices),
            options=opts,
            matched=refined.best.pose,
        )
