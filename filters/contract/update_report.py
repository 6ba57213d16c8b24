"""Outcome of an update: what became of each measurement."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filters.geometry.arrays import IntArray

_NO_IDS: IntArray = np.zeros(0, dtype=np.int64)
_NO_IDS.flags.writeable = False


def _no_ids() -> IntArray:
    return _NO_IDS


@dataclass(frozen=True, eq=False)
class UpdateReport:
    """Outcome of each measurement in one `update`, or of earlier ones where updates are delayed."""

    updated: IntArray = field(default_factory=_no_ids)
    """(K,): ids that corrected the state."""
    initialised: IntArray = field(default_factory=_no_ids)
    """(K,): ids that entered the map."""
    dropped: IntArray = field(default_factory=_no_ids)
    """(K,): ids that left the map."""
    gated: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose measurement failed the chi-square gate (Mahalanobis distance too large), in the first or in
    a later stage of the update; the stages before it have used the measurement."""
    rejected: IntArray = field(default_factory=_no_ids)
    """(K,): new ids the filter did not initialise from: it could not (for XYZ: d <= 0 or below `min_disparity`), or it
    has room for better ones only (`max_landmarks`)."""
    behind_camera: IntArray = field(default_factory=_no_ids)
    """(K,): known ids predicted behind the camera, so not used."""
    failed: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose innovation covariance had no Cholesky factor, or is so large that R is lost in its rounding
    (a landmark as good as in the image plane), so not used (or not in every stage)."""
    nis: float = 0.0
    """Normalised innovation squared over the accepted measurements, chi-square with `nis_dof` if consistent."""
    nis_dof: int = 0
    """Degrees of freedom of `nis`."""

    @property
    def failed_factorisations(self) -> int:
        """Number of `failed` measurements."""
        return len(self.failed)


@dataclass(frozen=True)
class Correction:
    """Outcome of a correction by a linearised measurement."""

    used: bool
    """Whether the state was corrected: the measurement passed the gate and its innovation covariance has a Cholesky
    factor."""
    nis: float
    """Normalised innovation squared, chi-square with `nis_dof` if consistent; -1 without a Cholesky factor."""
    nis_dof: int
    """Degrees of freedom of `nis`."""
