"""Divergence monitor: detects without truth, from the reports of updates, that a filter has diverged.

Two cumulative sums of log-likelihood ratios (Page's CUSUM, Biometrika 41, 1954), each of "gone wrong" against "as it
should be": of the normalised innovations squared, and of the share of known landmarks that could not be used. A sum
never falls below 0, so what was long ago does not count; a false alarm is as rare, per update, as e^-threshold at the
most. Besides, an alarm is raised where nothing of the map has been measured for long and the filter says that it
drifts, where all that is known is refused beside new landmarks, where the filter itself hardly knows its orientation,
and where the numbers are none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from filters.contract.outputs import PoseBelief, UpdateReport
from filters.contract.validation import positive

_TOLERATED, _LOST = 0.5, 0.9
"""Shares of known landmarks refused: the most that gross outliers are blamed for, and with a pose that is wrong."""


class Cause(Enum):
    """Reason of an alarm."""

    INNOVATIONS = "innovations larger than claimed"
    REFUSED = "most known landmarks refused"
    BLIND = "nothing known measured"
    CUT = "no link to the map"
    VAGUE = "orientation hardly known"
    NUMBERS = "not finite, or not positive definite"


@dataclass(frozen=True)
class Alarm:
    """A filter that should not be believed."""

    time: float
    """When it was raised, s since the monitor was made or reset."""
    cause: Cause
    """What the reports show."""
    words: str
    """With figures, one line."""


class DivergenceMonitor:
    """Listens to the updates of one filter, and raises an alarm when it has lost its way.

    What innovations cannot show it cannot see: a wrong baseline scales map and drive alike, and a camera that sees only
    a truck drives with it.

    Parameters
    ----------
    threshold : float
        Of the log-likelihood ratios, nats. The sums end there, so that an alarm ends soon after recovery.
    inflation : float
        NIS over its degrees of freedom, above 1, that is to be told from 1. What stays below
        ln(inflation) / (1 - 1 / inflation), 1.39 for 2, never raises an alarm.
    longest_blind : float
        For how long nothing of the map may be measured, s.
    farthest_blind : float
        By how much the claimed standard deviation of the position may grow while nothing is measured, for however long,
        m. A filter with odometry may well be blind.
    vaguest : float
        Standard deviation of the rotation up to which a linearised filter can be believed, rad.

    Raises
    ------
    ValueError
        An argument is impossible.
    """

    def __init__(
        self,
        *,
        threshold: float = 20.0,
        inflation: float = 2.0,
        longest_blind: float = 1.0,
        farthest_blind: float = 0.25,
        vaguest: float = 0.5,
    ) -> None:
        self._threshold, self._inflation = positive("threshold", threshold), positive("inflation", inflation)
        self._longest_blind, self._vaguest = positive("longest_blind", longest_blind), positive("vaguest", vaguest)
        self._farthest_blind = positive("farthest_blind", farthest_blind)
        if self._inflation <= 1.0:
            raise ValueError(f"inflation must be above 1, got {inflation!r}")
        self.reset()

    def reset(self) -> None:
        """Forget everything; the clock is 0."""
        self.time = 0.0
        """s since the monitor was made or reset."""
        self.alarm: Alarm | None = None
        """The first that was raised; None while there is none."""
        self.standing: Cause | None = None
        """Why there is an alarm now; None where the filter agrees with what it measures, also again."""
        self._innovations, self._refused = _Sum(self._threshold), _Sum(self._threshold)
        self._blind, self._sigma_seeing = 0.0, 0.0
        self._mapped = False

    def look(self, dt: float, report: UpdateReport, pose: PoseBelief | None = None) -> Alarm | None:
        """Take notice of an update.

        Parameters
        ----------
        dt : float
            Time since the update before, s; 0 for the first.
        report : UpdateReport
            What the update returned; an empty one where there was none.
        pose : PoseBelief, optional
            After it; None: its numbers are not looked at, and being blind for long is always told.

        Returns
        -------
        Alarm or None
            The alarm, if one is raised by this update.

        Raises
        ------
        ValueError
            dt is negative or not finite.
        """
        dt = positive("dt", dt, allow_zero=True)
        self.time += dt
        used, new = len(report.updated), len(report.initialised)
        refused = len(report.gated) + len(report.behind_camera) + len(report.failed)
        self._innovations.add(self._inflated(report.nis, report.nis_dof))
        self._refused.add(_lost(used, refused))
        cut = new > 0 and used == 0 and refused > 0
        drifts = self._drifts_blind(dt, used > 0 or (new > 0 and not self._mapped), pose)
        self._mapped = self._mapped or new > 0
        alarm: tuple[Cause, str] | None = None
        if not math.isfinite(report.nis) or (pose is not None and not _is_sound(pose)):
            alarm = Cause.NUMBERS, "NIS or the pose is not finite, or its covariance not positive definite"
        elif self._innovations.alarmed:
            alarm = Cause.INNOVATIONS, f"innovations are larger than claimed: NIS {report.nis:.3g} of {report.nis_dof}"
        elif self._refused.alarmed:
            alarm = Cause.REFUSED, f"{refused} of {used + refused} known landmarks refused"
        elif drifts:
            alarm = Cause.BLIND, f"no known landmark has been measured for {self._blind:.1f} s"
        elif cut:
            alarm = Cause.CUT, f"{new} landmarks are new, {refused} known ones refused, none used: a new start"
        elif pose is not None and (sigma := _rotation_sigma(pose)) > self._vaguest:
            alarm = Cause.VAGUE, f"the orientation is known to {sigma:.2g} rad: too little for a linearised filter"
        return self._told(alarm)

    def _drifts_blind(self, dt: float, seeing: bool, pose: PoseBelief | None) -> bool:
        """Whether no known landmark has been measured for long, and the filter says that it shows."""
        if seeing:
            self._blind, self._sigma_seeing = 0.0, 0.0 if pose is None else _position_sigma(pose)
            return False
        self._blind += dt
        far = pose is None or not _position_sigma(pose) - self._sigma_seeing <= self._farthest_blind
        return far and self._blind > self._longest_blind

    def _told(self, found: tuple[Cause, str] | None) -> Alarm | None:
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


class _Sum:
    """Page's sum, from 0 to the threshold; alarmed from when it gets there until it is back at 0."""

    def __init__(self, threshold: float) -> None:
        self._threshold, self._value, self.alarmed = threshold, 0.0, False

    def add(self, ratio: float) -> None:
        self._value = min(max(0.0, self._value + ratio), self._threshold)
        self.alarmed = self._value == self._threshold or (self.alarmed and self._value > 0.0)


def _lost(used: int, refused: int) -> float:
    """Log-likelihood ratio of a share `_LOST` refused against `_TOLERATED`; nats."""
    return refused * math.log(_LOST / _TOLERATED) + used * math.log((1.0 - _LOST) / (1.0 - _TOLERATED))


def _rotation_sigma(pose: PoseBelief) -> float:
    return math.sqrt(np.diagonal(pose.covariance)[3:].max())


def _position_sigma(pose: PoseBelief) -> float:
    """The largest of x, y, z; NaN where it is none."""
    return float(np.sqrt(np.diagonal(pose.covariance)[:3].max(initial=0.0)))


def _is_sound(pose: PoseBelief) -> bool:
    if not all(np.isfinite(part).all() for part in (pose.position, pose.orientation, pose.covariance)):
        return False
    try:
        np.linalg.cholesky(pose.covariance)
    except np.linalg.LinAlgError:
        return False
    return True
