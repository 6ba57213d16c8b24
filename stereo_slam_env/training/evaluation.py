"""Evaluation of a network on whole episodes, and the learning curve of a training."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

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
    """Run an episode for each seed; without a network the head looks straight ahead."""
    with threadpool_limits(1):
        rows = Parallel(processes)(delayed(_figures)(network, task, seed) for seed in seeds)
    return Evaluation(*(float(value) for value in np.mean(rows, axis=0)))


def _figures(network: Network | None, task: GazeTask, seed: int) -> list[float]:
    """The figures of `Evaluation`, of one episode."""
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


class LearningCurve:
    """Learning curve in a CSV file, read back when a training goes on.

    Parameters
    ----------
    file : Path
        Need not exist yet.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self.rows: list[dict[str, float]] = []
        if file.exists():
            with file.open(encoding="utf-8", newline="") as stream:
                self.rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]

    @property
    def seconds(self) -> float:
        """Time of the training so far, s."""
        return self.rows[-1]["seconds"] if self.rows else 0.0

    def add(self, decisions: int, seconds: float, mean_return: float, results: Evaluation) -> bool:
        """Add a row; whether it is the best so far, by the log det of the pose in the end."""
        row = {"decisions": float(decisions), "seconds": seconds, "mean_return": mean_return, **asdict(results)}
        best = all(results.final_pose_logdet < other["final_pose_logdet"] for other in self.rows)
        self.rows.append(row)
        with self._file.open("w", encoding="utf-8", newline="") as stream:
            columns = ("decisions", "seconds", "mean_return", *(field.name for field in fields(Evaluation)))
            writer = csv.DictWriter(stream, columns)
            writer.writeheader()
            writer.writerows({name: f"{value:.6g}" for name, value in row.items()} for row in self.rows)
        return best
