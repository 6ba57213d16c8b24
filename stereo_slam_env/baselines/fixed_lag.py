"""Fixed-lag smoothing on GTSAM's `BatchFixedLagSmoother`: a window of poses and its landmarks, solved every frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from filters import CameraState, StereoCamera, StereoNoise
from filters.contract.validation import whole_number
from filters.geometry.arrays import FloatArray
from stereo_slam_env.baselines.dead_reckoning import CameraBelief, symmetrised
from stereo_slam_env.baselines.guided_smoother import GuidedSmoother
from stereo_slam_env.baselines.smoothing_graph import Sightings, SmoothingGraph


class FixedLagSmoother(GuidedSmoother):
    """Fixed-lag smoothing by GTSAM: the last `lag` poses and what they see, solved again every frame.

    Poses older than that, and landmarks not seen since, are marginalised at the values they have then. Pose, velocity
    and their covariance are those of the window, not of the guide. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, **options
        See `GuidedSmoother`.
    lag : int
        Poses before the present one that stay in the window, 2 or more: the motion factors tie three.

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.

    References
    ----------
    GTSAM, `BatchFixedLagSmoother`, https://gtsam.org.
    """

    _graph: FixedLagGraph

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, lag: int = 10, **options: Any) -> None:
        self._lag = whole_number("lag", lag, 2)
        super().__init__(camera, noise, **options)

    def _new_graph(self, start: CameraState, P: FloatArray) -> FixedLagGraph:
        return FixedLagGraph(self.camera, start, P, self._tail_dof, self._lag)

    def _finish(self, believed: bool) -> None:
        self._located = {i: seen for i, seen in self._located.items() if seen[0] >= self._graph.last - self._lag}
        if believed and self._graph.last:
            self._solve()
            self._belief = CameraBelief(self._graph.state(), self._graph.covariance())


class FixedLagGraph(SmoothingGraph):
    """Factors that GTSAM's smoother does not have yet, and the values of its window.

    GTSAM's stamps are numbers of poses here, so that the window does not depend on the rate of the frames.
    """

    def __init__(
        self, camera: StereoCamera, start: CameraState, P: FloatArray, tail_dof: float | None, lag: int
    ) -> None:
        self._lag = lag
        self._stamps: dict[int, int] = {}  # by key, the last pose that each landmark of the window was seen from
        self._solved = -1
        self._given: list[tuple[Any, Any, dict[int, float]]] = []
        super().__init__(camera, start, P, tail_dof)
        self._smoother = self._gtsam.BatchFixedLagSmoother(lag)

    def __deepcopy__(self, memo: dict[int, Any]) -> FixedLagGraph:
        """GTSAM's smoother cannot be copied: the twin is given the same again, and has the same bits."""
        twin = super().__deepcopy__(memo)
        twin._stamps, twin._given = dict(self._stamps), list(self._given)
        twin._smoother = self._gtsam.BatchFixedLagSmoother(self._lag)
        for given in self._given:
            twin._smoother.update(*given)
        return twin

    def add_sightings(self, seen: Sightings, located: Mapping[int, tuple[int, FloatArray]]) -> Sightings:
        """As the full graph does; what has waited until its pose left the window is dropped."""
        return super().add_sightings(seen.select(seen.pose >= self.last - self._lag), located)

    def solve(self) -> None:
        """Hand over what is new; GTSAM solves the window and marginalises what has left it."""
        held = self._smoother.timestamps()
        new, stamps = self._gtsam.Values(), {key: float(pose) for key, pose in self._stamps.items()}
        for key in stamps:
            if key not in held:
                new.insert(key, self._values.atPoint3(key))
        for k in range(self._solved + 1, self.last + 1):
            key = self._pose_key(k)
            new.insert(key, self._values.atPose3(key))
            stamps[key] = float(k)
        given = self._factors, new, stamps
        self._smoother.update(*given)
        self._given.append(given)
        self._factors, self._stamps, self._solved = self._gtsam.NonlinearFactorGraph(), {}, self.last
        self._values = self._smoother.calculateEstimate()
        self._keys = {track: key for track, key in self._keys.items() if self._values.exists(key)}

    def covariance(self) -> FloatArray:
        """Covariance (12, 12) of the present state, whose velocity is that of the last move."""
        k = self.last
        marginals = self._gtsam.Marginals(self._smoother.getFactors(), self._values)
        keys = [self._pose_key(k - 1), self._pose_key(k)]
        J = self.last_move_jacobian()
        return symmetrised(J @ marginals.jointMarginalCovariance(keys).fullMatrix() @ J.T)

    def _add_sighting(self, key: int, pose: int, uvd: FloatArray, R: FloatArray) -> None:
        super()._add_sighting(key, pose, uvd, R)
        self._stamps[key] = max(pose, self._stamps.get(key, 0))
