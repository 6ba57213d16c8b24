"""How well a network does on whole episodes: what the filter claims in the end, and what is true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from stereo_slam_env.policies.interface import gaze_action
from stereo_slam_env.policies.network import Network
from stereo_slam_env.training.task import GazeTask


@dataclass(frozen=True)
class Evaluation:
    """Means over episodes.

    Attributes
    ----------
    final_position_sigma_m : float
        Root of the trace of the position covariance at the end.
    final_pose_logdet : float
        Natural logarithm of the determinant of the pose covariance at the end (m, rad).
    position_rmse_m : float
        Root mean square of the true position error over each episode.
    final_position_error_m : float
        True position error at the end.
    """

    final_position_sigma_m: float
    final_pose_logdet: float
    position_rmse_m: float
    final_position_error_m: float


def evaluate(network: Network | None, task: GazeTask, seeds: Sequence[int], *, processes: int = 1) -> Evaluation:
    """Run an episode for each seed, in so many processes; without a network the head looks straight ahead."""
    with threadpool_limits(1):
        rows = Parallel(processes)(delayed(_figures)(network, task, seed) for seed in seeds)
    return Evaluation(*(float(value) for value in np.mean(rows, axis=0)))


def _figures(network: Network | None, task: GazeTask, seed: int) -> list[float]:
    """Those of `Evaluation`, of one episode."""
    env = task.make_held()
    try:
        observation, info = env.reset(seed=seed)
        slam = env.get_wrapper_attr("slam")
        errors, over = [], False
        while not over:
            action = gaze_action(env, np.zeros(2) if network is None else network.action(observation))
            observation, _, terminated, truncated, info = env.step(action)
            errors.append(float(np.linalg.norm(slam.pose.position - info["truth_position"])))
            over = terminated or truncated
    finally:
        env.close()
    P = slam.pose.covariance
    rmse = float(np.sqrt(np.mean(np.square(errors))))
    return [float(np.sqrt(np.trace(P[:3, :3]))), float(np.linalg.slogdet(P)[1]), rmse, errors[-1]]
