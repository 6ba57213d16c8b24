"""Whether a filter has lost its way, told from what its updates report: for any filter, without truth.

Two cumulative sums of log-likelihood ratios (Page's CUSUM, Biometrika 41, 1954), each of "as it should be" against
"gone wrong": of the normalised innovations squared, and of the share of known landmarks that could not be used. A sum
never falls below 0, so what was long ago does not count; a false alarm is as rare, per update, as e^-threshold at the
most. Besides, an alarm is raised where nothing has been measured for long, and where the numbers are none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from filters.interface import PoseBelief, UpdateReport
from filters.validation import positive

_TOLERATED, _LOST = 0.5, 0.9
"""Shares of known landmarks refused: the most that gross outliers are blamed for, and with a pose that is wrong."""


class Cause(Enum):
    """Why an alarm is raised."""

    INNOVATIONS = "innovations larger than claimed"
    REFUSED = "most known landmarks refused"
    BLIND = "nothing measured"
    NUMBERS = "not finite, or not positive definite"


@dataclass(frozen=True)
class Alarm:
    """A filter that should not be believed.

    Attributes
    ----------
    time : float
        When it was raised, s since the monitor was made or reset.
    cause : Cause
        Why.
    words : str
        With figures, one line.
    """

    time: float
    cause: Cause
    words: str


class DivergenceMonitor:
    """Listens to the updates of one filter, and raises an alarm when it has lost its way.

    Parameters
    ----------
    threshold : float
        Of the log-likelihood ratios, nats.
    inflation : float
        NIS over its degrees of freedom, above 1, that is to be told from 1. What stays below
        ln(inflation) / (1 - 1 / inflation), 1.39 for 2, never raises an alarm.
    longest_blind : float
        For how long nothing may be measured, s.

    Raises
    ------
    ValueError
        An argument is impossible.
    """

    def __init__(self, *, threshold: float = 20.0, inflation: float = 2.0, longest_blind: float = 1.0) -> None:
        self._threshold = positive("threshold", threshold)
        if positive("inflation", inflation) <= 1.0:
            raise ValueError(f"inflation must be above 1, got {inflation!r}")
        self._inflation, self._longest_blind = float(inflation), positive("longest_blind", longest_blind)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the clock is 0."""
        self.time = 0.0
        """s since the monitor was made or reset."""
        self.alarm: Alarm | None = None
        """The first that was raised; None while there is none."""
        self.standing: Cause | None = None
        """Why there is an alarm now; None where the filter agrees with what it measures, also again."""
        self._innovations = self._refused = self._blind = 0.0

    def look(self, dt: float, report: UpdateReport, pose: PoseBelief | None = None) -> Alarm | None:
        """Take notice of an update.

        Parameters
        ----------
        dt : float
            Time since the update before, s; 0 for the first.
        report : UpdateReport
            What the update returned.
        pose : PoseBelief, optional
            After it; None: its numbers are not looked at.

        Returns
        -------
        Alarm or None
            The alarm, if one is raised by this update.
        """
        self.time += positive("dt", dt, allow_zero=True)
        used = len(report.updated)
        refused = len(report.gated) + len(report.behind_camera) + len(report.failed)
        self._blind = 0.0 if used + refused + len(report.initialised) else self._blind + dt
        self._innovations = max(0.0, self._innovations + self._inflated(report.nis, report.nis_dof))
        self._refused = max(0.0, self._refused + _lost(used, refused))
        found = self._found(report, used, refused, pose)
        before, self.standing = self.standing, None if found is None else found[0]
        if found is None or before is not None:
            return None
        raised = Alarm(self.time, *found)
        self.alarm = self.alarm or raised
        return raised

    def _inflated(self, nis: float, dof: int) -> float:
        """Log-likelihood ratio of innovations `inflation` times as large (in variance) as claimed; nats."""
        if not math.isfinite(nis):
            return math.inf
        return 0.5 * (nis * (1.0 - 1.0 / self._inflation) - dof * math.log(self._inflation))

    def _found(
        self, report: UpdateReport, used: int, refused: int, pose: PoseBelief | None
    ) -> tuple[Cause, str] | None:
        if pose is not None and not _is_sound(pose):
            return Cause.NUMBERS, "the pose is not finite, or its covariance not positive definite"
        if self._innovations > self._threshold:
            return Cause.INNOVATIONS, f"innovations are larger than claimed: NIS {report.nis:.3g} of {report.nis_dof}"
        if self._refused > self._threshold:
            return Cause.REFUSED, f"{refused} of {used + refused} known landmarks refused"
        if self._blind > self._longest_blind:
            return Cause.BLIND, f"nothing has been measured for {self._blind:.1f} s"
        return None


def _lost(used: int, refused: int) -> float:
    """Log-likelihood ratio of a share `_LOST` refused against `_TOLERATED`; nats."""
    return refused * math.log(_LOST / _TOLERATED) + used * math.log((1.0 - _LOST) / (1.0 - _TOLERATED))


def _is_sound(pose: PoseBelief) -> bool:
    values = (pose.position, pose.orientation, pose.covariance)
    if not all(np.isfinite(value).all() for value in values):
        return False
    try:
        np.linalg.cholesky(pose.covariance)
    except np.linalg.LinAlgError:
        return False
    return True
