"""`SubmapEKF`: a `StereoEKF` as active map, and a chain of inactive submaps."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import Forecast, LandmarkBelief, PoseBelief, UpdateReport, VelocityBelief
from filters.contract.stereo_filter import AT_ORIGIN, StereoFilter
from filters.contract.validation import unique_ids
from filters.engine.marginals import landmark_belief
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.parts import SLOTS
from filters.state.joint_state import JointState
from filters.submaps.chain import SubmapChain


class SubmapEKF(StereoFilter):
    """Keeps every landmark at a bounded cost a frame: submaps at rest behind a shared-anchor EKF.

    The estimates are those of `StereoEKF(..., drop_unseen=False)`: landmarks out of view are independent of all that
    follows given the camera and the landmarks in view at the moment they came to rest.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    max_unseen : int
        Landmarks out of view that the active map carries along before they come to rest. Few make frames cheap and
        submaps many.
    patience : int
        Updates without a measurement after which a landmark counts as out of view.
    landmark : str, mapping or LandmarkModel
        Parametrisation of landmarks, one that supports submaps: "shared-anchor", "inverse-depth" or "euclidean".
    **options
        Any of `StereoEKF`, but no `drop_unseen` and no error definition that turns all blocks together.

    Raises
    ------
    ValueError
        An option is unknown, or has an unknown or impossible value.
    """

    open_options = StereoEKF.open_options - {"landmark", "drop_unseen"}

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        max_unseen: int = 16,
        patience: int = 2,
        landmark: str = "shared-anchor",
        **options: Any,
    ) -> None:
        for name, value in (("max_unseen", max_unseen), ("patience", patience)):
            if type(value) is not int or value < 1:
                raise ValueError(f"{name} must be an integer >= 1, got {value!r}")
        known = inspect.signature(StereoEKF).parameters
        for name in options:
            if name not in known:
                raise ValueError(f"option {name!r} is not one of SubmapEKF: see StereoEKF, max_unseen and patience")
        if options.pop("drop_unseen", False):
            raise ValueError("drop_unseen must be False with submaps, got True: they keep every landmark")
        active = StereoEKF(camera, noise, landmark=landmark, drop_unseen=False, **options)
        for slot, able in (("landmark", _able("landmark")), ("error", _able("error"))):
            part = getattr(active.options, slot)
            if not part.submaps:
                raise ValueError(f"{slot} must be one of {able} with submaps, got {type(part).__name__}")
        self.camera = camera
        self.noise = noise
        self._max_unseen = max_unseen
        self._active = active
        self._chain = SubmapChain()
        self._recent: deque[IntArray] = deque(maxlen=patience)

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again with an empty map; see `StereoFilter.reset`."""
        self._active.reset(start)
        self._chain = SubmapChain()
        self._recent.clear()

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        self._active.predict(dt, odometry, inertial)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Landmarks at rest that are seen again are brought back first, those long unseen come to rest last."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        again = observation.ids[self._chain.at_rest(observation.ids)]
        if len(again):
            state = self._active.state
            self._chain.bring(state, again)
            self._active.state = state
        report = self._active.update(observation)
        self._recent.append(observation.ids)
        unseen = ~np.isin(self._active.ids, np.concatenate(self._recent))
        if unseen.sum() > self._max_unseen:
            state = self._active.state
            self._chain.rest(state, unseen)
            self._active.state = state
        return report

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks, at rest or not, at the current pose."""
        if ids is None:
            wanted = np.sort(np.concatenate([self._active.ids, self._chain.ids]))
        else:
            wanted = unique_ids("ids", np.asarray(ids))
        awake = wanted[~self._chain.at_rest(wanted)]
        parts = [self._active.forecast(awake)]
        missing = len(wanted) - len(awake)
        reader = deepcopy(self._active) if missing else self._active
        for view in self._views() if missing else ():
            here = np.intersect1d(wanted, view.ids)
            if len(here):
                reader.state = view
                parts.append(reader.forecast(here))
                missing -= len(here)
            if missing == 0:
                break
        told = np.concatenate([part.ids for part in parts])
        order = np.argsort(told)[np.argsort(np.argsort(wanted))]
        return Forecast(*(np.concatenate([vars(part)[name] for part in parts])[order] for name in vars(parts[0])))

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error and landmark positions; see the base class.

        Exact: landmarks at rest that are asked for are brought back into the active map of a copy. Ask sparingly.
        """
        everything = np.sort(np.concatenate([self._active.ids, self._chain.ids]))
        wanted = everything if ids is None else unique_ids("ids", np.asarray(ids))
        asleep = wanted[self._chain.at_rest(wanted)]
        if len(asleep) == 0:
            return self._active.joint_covariance(wanted)
        awake = deepcopy(self)
        state = awake._active.state
        awake._chain.bring(state, asleep)
        awake._active.state = state
        return awake._active.joint_covariance(wanted)

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        gone = unique_ids("ids", np.asarray(ids))
        self._active.forget(gone)
        self._chain.forget(gone)

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        return self._active.pose

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        return self._active.velocity

    @property
    def landmarks(self) -> LandmarkBelief:
        """The whole map, in ascending order of ids; corrections are carried back to all submaps, so ask sparingly."""
        parts = [self._active.landmarks, *(landmark_belief(view) for view in self._views())]
        order = np.argsort(np.concatenate([part.ids for part in parts]))
        return LandmarkBelief(*(np.concatenate([vars(part)[name] for part in parts])[order] for name in vars(parts[0])))

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose in this filter's error definition; see `StereoFilter.pose_error`."""
        return self._active.pose_error(position, orientation)

    @property
    def submaps(self) -> int:
        """Number of submaps at rest."""
        return len(self._chain)

    @property
    def awake(self) -> IntArray:
        """Landmarks of the active map, ascending; all others are at rest."""
        return np.sort(self._active.ids)

    @property
    def size(self) -> int:
        """Number of landmarks in the map, cheaper to ask than `landmarks`."""
        return len(self._active.ids) + len(self._chain.ids)

    @property
    def state_size(self) -> int:
        """Rows of the active error state, which decide what a frame costs."""
        return self._active.state_size

    @property
    def nbytes(self) -> int:
        """Memory of the covariances, bytes: of the active map and of all submaps."""
        at_rest = sum(submap.gain.nbytes + submap.covariance.nbytes for submap in self._chain.submaps)
        return self._active.state.P.nbytes + at_rest

    def _views(self) -> Iterator[JointState]:
        """The submaps at rest, newest first, each with the present camera."""
        return self._chain.seen_from(self._active.state)


def _able(slot: str) -> str:
    """Names of the parts that support submaps."""
    named = SLOTS[slot].named
    return ", ".join(repr(name) for name, kind in named.items() if kind.submaps)  # type: ignore[attr-defined]
