"""The calibrated pair of landmarks whose measurements err by numbers of their own: (u, v, d) plus these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from filters.geometry.machine_code import compiled
from filters.measurements.calibrated_pair import EXACT, CalibratedPair
from filters.measurements.measurement_model import Numbers

_project, _unproject = compiled(CalibratedPair.project), compiled(CalibratedPair.unproject)


@dataclass(frozen=True)
class PairWithLastingErrors(CalibratedPair):
    """One joint update with (u, v, d) of a `CalibratedPair`, plus the errors of the landmark that last, px.

    Landmarks are `LastingErrors`; parameters are those of `CalibratedPair`, and without them the rig is exact (Eq. 10).
    """

    seen_size: ClassVar[int] = 7

    def project(self, camera: Any, h: Numbers, values: Any = EXACT) -> Numbers:
        """(u, v, d) with the errors."""
        u, v, d = _project(self, camera, h, values)
        return u + h[4], v + h[5], d + h[6]

    def unproject(self, camera: Any, uvd: Numbers, values: Any = EXACT) -> Numbers:
        """The point as if there were no errors of its own."""
        x, y, z, scale = _unproject(self, camera, uvd, values)
        return x, y, z, scale, 0.0, 0.0, 0.0
