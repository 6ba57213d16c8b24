"""A filter that drives well and claims covariances that are none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from filters import Forecast, InverseDepthStereoEKF, PoseBelief, Start, StereoObservation, UpdateReport
from filters.contract.stereo_filter import AT_ORIGIN

FROM = 10
"""The claims are true before this update."""

LIES: dict[str, Callable[[Any], Any]] = {
    "zero": np.zeros_like,
    "negative": np.negative,
    "NaN": lambda P: np.full_like(P, np.nan),
    "asymmetric": lambda P: P + 1e-6 * P.max() * np.tri(P.shape[-1], k=-1),
}


def liar(where: str, lie: str | Callable[[Any], Any], first: int = FROM) -> type[InverseDepthStereoEKF]:
    """A filter that claims something else in one place from some update on."""

    class Liar(InverseDepthStereoEKF):
        updates = 0

        def reset(self, start: Start = AT_ORIGIN) -> None:
            super().reset(start)
            self.updates = 0

        def update(self, observation: StereoObservation) -> UpdateReport:
            self.updates += 1
            return super().update(observation)

        def claim(self, place: str, P: Any) -> Any:
            told = LIES[lie] if isinstance(lie, str) else lie
            return told(P) if place == where and self.updates >= first else P

        @property
        def pose(self) -> Any:
            pose = super().pose
            return dataclasses.replace(pose, covariance=self.claim("pose", pose.covariance))

        @property
        def velocity(self) -> Any:
            velocity = super().velocity
            return dataclasses.replace(velocity, covariance=self.claim("velocity", velocity.covariance))

        @property
        def landmarks(self) -> Any:
            landmarks = super().landmarks
            return dataclasses.replace(landmarks, covariances=self.claim("landmarks", landmarks.covariances))

        def pose_error(self, position: Any, orientation: Any) -> Any:
            error, covariance = super().pose_error(position, orientation)
            return error, self.claim("pose_error", covariance)

        def relative_pose(self, name: str) -> PoseBelief:
            moved = super().relative_pose(name)
            return dataclasses.replace(moved, covariance=self.claim("relative_pose", moved.covariance))

        def forecast(self, ids: Any = None) -> Forecast:
            forecast = super().forecast(ids)
            own = self.claim("forecast", forecast.S - self.noise.R)
            return dataclasses.replace(forecast, S=own + self.noise.R)

    return Liar
