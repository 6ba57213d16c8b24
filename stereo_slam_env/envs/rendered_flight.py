"""A flight through a scene as rendered stereo images, with the samples of an inertial unit, at any rates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose, Start, StereoCamera
from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.arguments import DriveOptions
from stereo_slam_env.envs.core_rows import CoreRows
from stereo_slam_env.envs.recorder import NOT_DRAWN, described
from stereo_slam_env.envs.row_pictures import Pictures
from stereo_slam_env.recording.recording import SIMULATION, Reference, StereoPair, Velocity
from stereo_slam_env.rendering.pinhole import grey
from stereo_slam_env.sensing.imu import GRAVITY, Imu
from stereo_slam_env.sensing.smooth_paths import flown_path, velocity_on

_DOWN = np.array([0.0, 1.0, 0.0])


class RenderedFlight:
    """A camera that is carried to and fro at the start of a route, in six degrees of freedom; an `ImageSequence`.

    Parameters
    ----------
    env_kwargs : mapping, optional
        Arguments of `StereoDriveEnv` for the scene, the rig, the renderer and the inertial unit (`imu`, which may be
        None). Bodies that move are refused: they keep the frames of a drive.
    seed : int
        Seed of the scene, the path and the errors of the unit: same seed, same bits.
    frames : int
        Number of pairs.
    rate, imu_rate : float
        Pairs and samples a second.

    Raises
    ------
    ValueError
        An argument is not allowed.
    """

    draws_on_demand = True

    def __init__(
        self,
        env_kwargs: Mapping[str, Any] | None = None,
        seed: int = 0,
        frames: int = 400,
        *,
        rate: float = 20.0,
        imu_rate: float = 200.0,
    ) -> None:
        arguments = {"route": "straight", **(env_kwargs or {}), "policy": "route", "vehicle": "smooth"}
        self.options = options = DriveOptions.checked({**arguments, "sensor": "landmarks", "render_images": False})
        if options.moving_cars or options.pedestrians or options.bus:
            raise ValueError(
                "moving_cars, pedestrians and bus must be left out of a flight: they move by frames of 0.1 s"
            )
        self._seed, self._count = seed, whole_number("frames", frames, 2)
        self.rate, self.imu_rate = positive("rate", rate), positive("imu_rate", imu_rate)
        self.camera: StereoCamera = options.camera
        self.name = f"{options.surroundings}-flight-{seed}"
        self.truth_from: Reference = SIMULATION
        self.skipped: Mapping[str, int] = {}
        self._path = flown_path(np.random.default_rng([seed, 0]))
        self._origin, self._R_0 = (ends[0] for ends in self._path(np.zeros(1)))
        self.gravity: FloatArray = GRAVITY * self._R_0.inv().apply(_DOWN)
        """Acceleration of a body that falls, in W, m/s^2."""
        velocity = velocity_on(self._in_w, 0.0)
        self.start = Start(linear_velocity=velocity[:3], angular_velocity=velocity[3:])
        about = {**described(options, seed), "flight": {"rate": self.rate, "imu_rate": self.imu_rate}}
        self.source: Mapping[str, Any] = {**about, "frames": self._count}

    def _in_w(self, t: FloatArray) -> tuple[FloatArray, Rotation]:
        """The path in W, the first camera."""
        positions, R = self._path(t)
        return self._R_0.inv().apply(positions - self._origin), self._R_0.inv() * R

    def __len__(self) -> int:
        return self._count

    def pairs(self, is_drawn: Callable[[int, float], bool] = lambda number, time: True) -> Iterator[StereoPair]:
        """The pairs in time order; those whose number and time, s, are not to be drawn have images of no size."""
        with closing(CoreRows(self.options, 1)) as rows:
            rows.reset(np.ones(1, dtype=np.bool_), [self._seed], {})
            scene = rows.simulator.scenes[0]
        assert scene is not None
        times = np.arange(self._count) / self.rate
        unit = None if self.options.imu is None else Imu(self.options.data_sheet, rate=self.imu_rate)
        measured: Iterator[Any] = iter([(None, None)] * self._count)
        if unit is not None:
            measured = unit.measured(self._in_w, times, self.gravity, np.random.default_rng([self._seed, 1]))
        with closing(Pictures(self.options, self.camera)) as pictures:
            pictures.build(scene.scene, np.random.default_rng([self._seed, 2]))
            for number, (t, (samples, biases)) in enumerate(zip(times.tolist(), measured, strict=True)):
                grey_images = NOT_DRAWN, NOT_DRAWN
                (position,), (turn,) = self._path(np.array([t]))
                if is_drawn(number, t):
                    pictures.set_frame(number)
                    images = pictures.images(Pose(position, turn.as_quat()))
                    grey_images = grey(images.left), grey(images.right)
                (position,), (turn,) = self._in_w(np.array([t]))
                velocity = velocity_on(self._in_w, t)
                yield StereoPair(
                    t,
                    *grey_images,
                    truth=Pose(position, turn.as_quat()),
                    inertial=samples,
                    velocity=Velocity(velocity[:3], velocity[3:]),
                    biases=biases,
                )
