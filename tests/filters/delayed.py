"""An EKF with delayed updates, as fixed-lag and multi-state-constraint filters have them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from operator import attrgetter
from typing import Any

import numpy as np

from filters import (
    BodyVelocity,
    Forecast,
    InverseDepthStereoEKF,
    StereoCamera,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    UpdateReport,
)

LONGEST_WAIT = 10
FATES = ("updated", "initialised", "gated", "rejected", "behind_camera", "failed")


class DelayedEKF(StereoFilter):
    """The paper's filter, told of a frame later; what it shows is predicted from there to now.

    Parameters
    ----------
    until_tracks_end : bool
        Frames wait until a landmark seen in them is not seen any more (or there are `LONGEST_WAIT`), and then all are
        used; else each waits for the next one.
    """

    open_options = InverseDepthStereoEKF.open_options

    def __init__(
        self, camera: StereoCamera, noise: StereoNoise, *, until_tracks_end: bool = False, **options: Any
    ) -> None:
        self.camera, self.noise = camera, noise
        self._until_tracks_end = until_tracks_end
        self._past = InverseDepthStereoEKF(camera, noise, **options)
        self._forget_the_frames()

    def _forget_the_frames(self) -> None:
        self._now = deepcopy(self._past)
        self._steps: list[tuple[float, BodyVelocity | None]] = []
        self._waiting: list[tuple[list[tuple[float, BodyVelocity | None]], StereoObservation]] = []

    def reset(self, *args: Any, **kwargs: Any) -> None:
        self._past.reset(*args, **kwargs)
        self._forget_the_frames()

    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        self._now.predict(dt, odometry)
        self._steps.append((dt, odometry))

    def update(self, observation: StereoObservation) -> UpdateReport:
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        self._waiting.append((self._steps, observation))
        self._steps = []
        due = len(self._waiting) - 1
        if self._until_tracks_end and due < LONGEST_WAIT:
            seen = [frame.ids for _, frame in self._waiting]
            due = due if not np.isin(np.concatenate(seen), observation.ids).all() else 0
        reports = []
        for steps, frame in self._waiting[:due]:
            self._move(self._past, steps)
            reports.append(self._past.update(frame))
        self._waiting = self._waiting[due:]
        self._now = deepcopy(self._past)
        for steps, _ in self._waiting:
            self._move(self._now, steps)
        return _together(reports)

    @staticmethod
    def _move(stereo_filter: StereoFilter, steps: list[tuple[float, BodyVelocity | None]]) -> None:
        for step in steps:
            stereo_filter.predict(*step)

    def forget(self, ids: Sequence[int] | np.ndarray) -> None:
        self._past.forget(ids)
        self._now.forget(ids)
        self._waiting = [(steps, frame.select(~np.isin(frame.ids, ids))) for steps, frame in self._waiting]

    def forecast(self, ids: Sequence[int] | np.ndarray | None = None) -> Forecast:
        return self._now.forecast(ids)

    pose, velocity, landmarks = (property(attrgetter(f"_now.{name}")) for name in ("pose", "velocity", "landmarks"))

    def pose_error(self, position: Any, orientation: Any) -> tuple[np.ndarray, np.ndarray]:
        return self._now.pose_error(position, orientation)


def _together(reports: list[UpdateReport]) -> UpdateReport:
    """One report on several frames: the last word on each landmark."""
    last = {i: fate for report in reports for fate in FATES for i in getattr(report, fate).tolist()}
    parts = {fate: np.array([i for i, own in last.items() if own == fate], dtype=np.int64) for fate in FATES}
    return UpdateReport(**parts, nis=sum(r.nis for r in reports), nis_dof=sum(r.nis_dof for r in reports))
