"""Equivariant output (van Goor and Mahony 2023): whether the mean of two Jacobians makes `inertial` better.

    python benchmarks/equivariant_output.py --seeds 200      # ten minutes

(u, v, d) under a rotation and a scale of the point, SOT(3), is equivariant where d > 0. The mean of its Jacobians at
the measured and at the predicted values then leaves an error of third order in place of second. Paired runs of that
and of Jacobians at the prediction, flights and drives of 10 s; the filter is told the noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import Extended, StereoCamera
from harness import arguments, show
from stereo_slam_env import evaluate
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive, inertial_flight

FRAMES, DRAWS = 100, 10_000


class EquivariantOutput(Extended):
    """H by the mean of the Jacobians at the measured and at the predicted values."""

    kernels = False

    def linearise(
        self, sensor: Any, camera: StereoCamera, state: Any, index: Any, stage: Any, point: Any = None
    ) -> Any:
        """As `Extended`, through a sensor whose Jacobians are means."""
        return super().linearise(_Mean(sensor, stage.z), camera, state, index, stage, point)


class _Mean:
    """A sensor of (u, v, d) that has measured z (M, 3)."""

    def __init__(self, sensor: Any, z: NDArray[np.float64]) -> None:
        self._sensor, self._z = sensor, z

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)

    def jacobians(self, camera: StereoCamera, points_c: NDArray[np.float64], values: Any) -> Any:
        """Means, where the predicted and the measured disparity are above 0."""
        predicted = self._sensor.jacobians(camera, points_c, values)
        measured = np.column_stack([camera.ray(self._z), self._z[:, 2] / camera.disparity_constant])
        good = (measured[:, 3] > 0.0) & (points_c[:, 3] > 0.0)
        at, of = points_c[good], measured[good]
        generators, rates = np.zeros((2, len(at), 4, 4))  # of the group at what is measured; of the error at the point
        generators[:, :3, :3], generators[:, 3, 3] = -_cross(of[:, :3]), of[:, 3]
        square = np.sum(at[:, :3] ** 2, axis=1)[:, None]
        rates[:, :3, :3], rates[:, 3, 3] = _cross(at[:, :3]) / square[:, :, None], 1.0 / at[:, 3]
        rates[:, 3, :3] = -at[:, :3] / square
        J = self._sensor.jacobians(camera, of, values).by_point @ generators @ rates
        predicted.by_point[good] = 0.5 * (predicted.by_point[good] + J)
        return predicted


def _cross(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.cross(v[:, None, :], np.eye(3)[None]).swapaxes(1, 2)


def main() -> None:
    """Rows of problems: RMS position and rotation error of both, their ratio with its 95 % interval, NEES/6."""
    given = arguments(__doc__, seeds=200)
    rows = []
    for label, problem, landmarks in (("flights", inertial_flight, 40), ("drives", inertial_drive, 40)):
        found = np.empty((given.seeds, 2, 3))
        for seed in range(given.seeds):
            recording = problem(seed, frames=FRAMES, landmarks=landmarks)
            for i, update in enumerate(("extended", EquivariantOutput())):
                figures = evaluate("inertial", recording, gate=None, use_odometry=False, update=update).figures
                found[seed, i] = figures.position_rmse_m, figures.rotation_rmse_deg, figures.pose_anees / 6.0
        for what, k in (("position, m", 0), ("rotation, deg", 1)):
            squares = found[:, :, k] ** 2
            drawn = squares[np.random.default_rng(0).integers(0, given.seeds, (DRAWS, given.seeds))].mean(axis=1)
            low, high = np.quantile(np.sqrt(drawn[:, 1] / drawn[:, 0]), [0.025, 0.975])
            (usual, mean), (nees, nees_mean) = np.sqrt(squares.mean(axis=0)), found[:, :, 2].mean(axis=0)
            ratio = f"{mean / usual:.4f} ({low:.4f} to {high:.4f})"
            rows.append([label, what, f"{usual:.4f}", f"{mean:.4f}", ratio, f"{nees:.3f}", f"{nees_mean:.3f}"])
    show(
        f"{given.seeds} paired runs each, RMS over all",
        ["runs", "error", "usual", "equivariant", "ratio (95 %)", "NEES/6 usual", "equivariant"],
        rows,
    )


if __name__ == "__main__":
    main()
