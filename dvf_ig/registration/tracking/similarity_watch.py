"""A change that no rigid pose explains: the similarity at each beat's best pose, against its own history.

Similarity depends on the view, so each beat is compared with earlier ones whose planes lay near its own:

    ŝ   mean of earlier beats' similarity, weighted by exp(−d²/2w²), d the distance between the views
    z   (ŝ − s) / σ,   σ robust standard deviation of such differences, widened for their correlation
    g ← max(0, g + z − k)                                     one-sided CUSUM, alarm beyond LIMIT

Deformation, insufflation, an effusion, or a view that slipped lower the similarity and keep it low. A beat
that raises g beyond half the limit does not count as history, so that a slow change is not learnt as normal.

Source: Page 1954, Continuous inspection schemes; Siegmund 1985 (average run length); Nadaraya 1964 (ŝ).
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays

VIEW_WIDTH_MM = 8.0
"""w: a sweep that comes back passes 9 mm from where it was (tuning hearts 1001–1004), where it takes the
standard deviation of the differences from 0.028 to 0.020 calm."""
ANY_VIEW = 0.02
"""Weight of a beat however far its view: the first beats of a view are compared with all."""
LEARNT_BEATS, REMEMBERED_BEATS = 12, 120
"""Beats needed before anything is stated, about a sweep; and beats remembered."""
SIGMA, CORRELATED = (0.015, 0.04), 1.4
"""Smallest and largest σ, and what it is widened by: those of neighbouring beats correlate, 0.1 to 0.5."""
ALLOWANCE, LIMIT = 0.5, 8.0
"""k and the limit of g: one alarm in 19 000 beats of independent normal z (Siegmund), 0.23 an hour. Quiet
tuning hearts 1001–1007 reach 2.9 calm, 4.3 with poor images (740 beats). Deformed by 5 mm RMS they are found
within 6 beats calm, within 20 or not at all with poor images; by 3 mm within 22 calm, else mostly not."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SimilarityWatch:
    """Memory of earlier beats.

    Attributes:
        views_mm: (n, 3, 3) three points of each beat's mean plane, frame of the slices.
        similarity: (n,) at each beat's best pose.
        differences: (m,) latest ŝ − s, each over the uncertainty of its ŝ.
        cusum: g.
        since_s: begin of the beat from which on g has been above 0.
    """

    views_mm: FloatArray
    similarity: FloatArray
    differences: FloatArray
    cusum: float = 0.0
    since_s: float = 0.0

    @classmethod
    def new(cls) -> "SimilarityWatch":
        return cls(np.empty((0, 3, 3)), np.empty(0), np.empty(0))

    @property
    def alarm(self) -> bool:
        return self.cusum > LIMIT

    def after(self, begin_s: float, view_mm: FloatArray, similarity: float) -> "SimilarityWatch":
        """With one more beat, begun at `begin_s`: its view (3, 3) and its best similarity."""
        if len(self.similarity) < LEARNT_BEATS:
            return self._remembering(view_mm, similarity, self.differences, 0.0, begin_s)
        apart = np.linalg.norm(self.views_mm - view_mm, axis=2).mean(axis=1)
        weight = np.exp(-0.5 * (apart / VIEW_WIDTH_MM) ** 2) + ANY_VIEW
        weight /= weight.sum()
        difference = (weight @ self.similarity - similarity) / np.sqrt(1.0 + weight @ weight)
        cusum = max(0.0, self.cusum + difference / self._sigma() - ALLOWANCE)
        since_s = self.since_s if self.cusum > 0.0 else begin_s
        latest = np.append(self.differences, difference)[-REMEMBERED_BEATS:]
        if cusum > LIMIT / 2:
            return SimilarityWatch(self.views_mm, self.similarity, latest, cusum, since_s)
        return self._remembering(view_mm, similarity, latest, cusum, since_s)

    def _sigma(self) -> float:
        """Robust standard deviation of the differences; the largest until there are enough."""
        if len(self.differences) < LEARNT_BEATS:
            return CORRELATED * SIGMA[1]
        spread = 1.4826 * float(np.median(np.abs(self.differences - np.median(self.differences))))
        return CORRELATED * min(max(spread, SIGMA[0]), SIGMA[1])

    def _remembering(
        self, view_mm: FloatArray, similarity: float, differences: FloatArray, cusum: float, since_s: float
    ) -> "SimilarityWatch":
        views = np.concatenate([self.views_mm, view_mm[None]])[-REMEMBERED_BEATS:]
        similarities = np.append(self.similarity, similarity)[-REMEMBERED_BEATS:]
        return SimilarityWatch(views, similarities, differences, cusum, since_s)
