"""Little third-party filters, laid out on the path as an installer would, with entry points.

`odometry-only` integrates odometry and knows nothing of gates or motion models; `raises` fails in its third update;
`returns-nan` loses its position in its third; `crashes` takes its process down in its third, `hangs` never returns from
it, `waits` leaves a file "waiting" and waits for a file "go"; `listens` writes down a digest of everything it is given;
`its-own-way` is an EKF with a motion model of its own.
"""

from __future__ import annotations

from pathlib import Path

import pytest

MODULE = '''
"""Filters of somebody else."""

import hashlib
import os
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Forecast, LandmarkBelief, MotionModel, PoseBelief, Start, StereoEKF, StereoFilter
from filters import UpdateReport, VelocityBelief, vectors


class DeadReckoning(StereoFilter):
    """Integrates the odometry and maps nothing."""

    def __init__(self, camera, noise, *, spread=0.1):
        self.camera, self.noise, self.spread = camera, noise, spread
        self.reset()

    def reset(self, start=Start()):
        self.r, self.R = np.array(start.position), Rotation.from_quat(start.orientation)
        self.v, self.updates = np.array(start.linear_velocity), 0

    def predict(self, dt, odometry=None):
        if odometry is None:
            self.r = self.r + self.v * dt
            return
        half = self.R * Rotation.from_rotvec(0.5 * dt * odometry.angular)
        self.v = half.as_matrix() @ odometry.linear
        self.r, self.R = self.r + self.v * dt, self.R * Rotation.from_rotvec(dt * odometry.angular)

    def update(self, observation):
        self.updates += 1
        return UpdateReport()

    def forecast(self, ids=None):
        return Forecast(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool))

    def forget(self, ids):
        pass

    @property
    def pose(self):
        return PoseBelief(self.r, self.R.as_quat(), self.spread**2 * np.eye(6))

    @property
    def velocity(self):
        return VelocityBelief(self.v, np.zeros(3), np.eye(6))

    @property
    def landmarks(self):
        none = np.zeros(0)
        return LandmarkBelief(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), none, none)

    def pose_error(self, position, orientation):
        turn = (self.R.inv() * Rotation.from_quat(np.array(orientation))).as_rotvec()
        return np.concatenate([np.array(position) - self.r, turn]), self.pose.covariance


class Raises(DeadReckoning):
    """Raises in the third update."""

    def update(self, observation):
        if self.updates == 2:
            raise RuntimeError("the third frame is too much\\nand this is a second line")
        return super().update(observation)


class ReturnsNaN(DeadReckoning):
    """Loses its position in the third update."""

    def update(self, observation):
        if self.updates == 2:
            self.r = np.full(3, np.nan)
        return super().update(observation)


class Crashes(DeadReckoning):
    """Takes its process down in the third update."""

    def update(self, observation):
        if self.updates == 2:
            os._exit(7)
        return super().update(observation)


class Hangs(DeadReckoning):
    """Never returns from its third update."""

    def update(self, observation):
        while self.updates == 2:
            pass
        return super().update(observation)


class ItsOwnWay(StereoEKF):
    """Glides."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, noise, motion=Gliding(), **options)


class Gliding(MotionModel):
    def step(self, x, dt, n):
        velocity = vectors.plus(x.linear_velocity, n[:3], 1.0)
        turn = vectors.plus(x.angular_velocity, n[3:], 1.0)
        orientation = vectors.product(x.orientation, vectors.quaternion(vectors.scaled(dt, turn)))
        return vectors.plus(x.position, velocity, dt), orientation, velocity, turn

    def sigmas(self, dt):
        return 2.0 * dt, 2.0 * dt, 2.0 * dt, 0.2 * dt, 0.2 * dt, 0.2 * dt


class Waits(DeadReckoning):
    """Says in the working directory that it waits, until it is told there to go on."""

    def update(self, observation):
        Path("waiting").touch()
        while not Path("go").exists():
            time.sleep(0.01)
        return super().update(observation)


class Listens(DeadReckoning):
    """Writes down a digest of what it is given."""

    def __init__(self, camera, noise, *, notebook="notes"):
        self.notebook, self.heard = notebook, hashlib.sha256()
        super().__init__(camera, noise)

    def reset(self, start=Start()):
        super().reset(start)
        self._hear("reset", start.position, start.linear_velocity, start.angular_velocity)

    def predict(self, dt, odometry=None):
        super().predict(dt, odometry)
        self._hear("predict", dt, *([] if odometry is None else [odometry.linear, odometry.angular]))

    def update(self, observation):
        self._hear("update", observation.ids, observation.uvd, observation.v_right)
        return super().update(observation)

    def _hear(self, what, *values):
        self.heard.update(what.encode())
        for value in values:
            self.heard.update(b"-" if value is None else np.ascontiguousarray(value).tobytes())
        Path(self.notebook).write_text(self.heard.hexdigest())
'''

ENTRY_POINTS = {
    "its-own-way": "ItsOwnWay",
    "odometry-only": "DeadReckoning",
    "raises": "Raises",
    "returns-nan": "ReturnsNaN",
    "crashes": "Crashes",
    "hangs": "Hangs",
    "waits": "Waits",
    "listens": "Listens",
}


def install(
    folder: Path, name: str, module: str, entry_points: dict[str, str], group: str = "stereo_slam.filters"
) -> None:
    """Lay out the distribution `name` with one module of the same name."""
    (folder / f"{name}.py").write_text(module, encoding="utf-8")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{key} = {name}:{value}" for key, value in entry_points.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]))


@pytest.fixture
def third_party(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder on the path in which they are installed."""
    folder = tmp_path / "site"
    folder.mkdir()
    install(folder, "somebodys_filters", MODULE, ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "somebodys_filters", raising=False)
    return folder
