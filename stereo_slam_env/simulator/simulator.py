"""`Simulator`: the world in motion, of one vehicle or of many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.validation import unchecked
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import Pose
from stereo_slam_env.recording.body_truth import BODY_KINDS, BodyTruth
from stereo_slam_env.recording.recording import Frame, Velocity
from stereo_slam_env.sensing.corruptions import PixelNoise
from stereo_slam_env.sensing.imu import Imu, UnitErrors
from stereo_slam_env.simulator.frame_kernel import FIRST, JUDGE, MOVE, SENSE, STEP, WAIT, run_frame
from stereo_slam_env.simulator.moving_truth import bodies_now, bodies_of_measurements
from stereo_slam_env.simulator.rays import traversal
from stereo_slam_env.simulator.scene_arrays import (
    SceneArrays,
    Shown,
    put_route,
    put_scene,
    show,
    with_room,
)
from stereo_slam_env.simulator.sensing import Streams
from stereo_slam_env.simulator.state import NO_NOISE, NOISE_KINDS, RIDE_STEPS, Kept, Rules, empty_fleet, empty_sensed
from stereo_slam_env.world.routes import Route

if TYPE_CHECKING:
    from stereo_slam_env.simulator.bullet import BulletAnswers

START_SIGMAS: FloatArray = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
"""What is known at the start of position, rotation, linear and angular velocity: m, rad, m/s, rad/s."""
START_SIGMAS.flags.writeable = False
Physics = Literal["exact", "bullet"]
_FRAMES_AHEAD = 16
"""For so many frames random numbers are drawn ahead."""


class Simulator(Kept):
    """B vehicles, each in a scene of its own, with cameras, odometry, and random generators.

    A row has the same bits whatever the number of rows and threads.

    Parameters
    ----------
    rules : Rules
        What all rows do, see `make_rules`.
    count : int
        B.
    noise : PixelNoise
        That of the rules.
    threads : int
        Threads over which the rows are spread.
    imu : Imu, optional
        Inertial unit on the camera, of rules with a smooth ride.
    senses : bool
        Whether landmarks are measured here. Otherwise `sensed` is filled by `sense`, of `move` and `judge`.
    """

    changes = (
        *("fleet", "sensed", "scenes", "_streams", "_noise_generators", "_start_errors", "_first_velocities"),
        "_unit_errors",
    )

    def __init__(
        self,
        rules: Rules,
        count: int,
        noise: PixelNoise,
        threads: int = 1,
        *,
        imu: Imu | None = None,
        senses: bool = True,
    ) -> None:
        self.rules, self.count, self.threads = rules, count, min(threads, count)
        normals = (8 if rules.lasting[0] else 4) * rules.room  # of the noise of a frame
        self.fleet = empty_fleet(count, max(_FRAMES_AHEAD * normals, 512), lasting=rules.lasting[0] > 0)
        self.sensed = empty_sensed(count, rules.room, RIDE_STEPS if rules.smooth else 0)
        self._imu = imu
        self._unit_errors: list[UnitErrors | None] = [None] * count
        self.scenes: list[SceneArrays | None] = [None] * count
        """Of the rows."""
        self.bullet: BulletAnswers | None = None
        """PyBullet's worlds, where the rules are not exact."""
        if not rules.exact:
            from stereo_slam_env.simulator.bullet import BulletAnswers  # needs PyBullet

            self.bullet = BulletAnswers(count)
        self._senses = senses
        self._streams = Streams(count, np.array([6, 6, normals, 0]))
        self._noise = noise
        self._noise_generators: list[np.random.Generator | None] = [None] * count
        self._start_errors, self._first_velocities = np.zeros((count, 6)), np.zeros((count, 6))
        self.odometry_covariance: FloatArray = np.diag(rules.odometry_sigmas**2)
        self.odometry_covariance.flags.writeable = False
        self._rooms = [traversal() for _ in range(self.threads)]
        self._doing: IntArray = np.zeros(count, dtype=np.int64)
        self._commands = np.zeros((count, 0))
        self._workers: ThreadPoolExecutor | None = None

    def restore(self, state: Mapping[str, Any]) -> None:
        """PyBullet's worlds follow."""
        before = self.scenes
        super().restore(state)
        for b, scene in enumerate(self.scenes):
            if self.bullet is not None and scene is not None and scene is not before[b]:
                self.bullet.build(b, scene.scene)

    def put(self, b: int, scene: SceneArrays, generators: Sequence[np.random.Generator]) -> None:
        """Give row b a scene and the generators of its next episode: of motion, landmarks, odometry, start, IMU."""
        motion, landmark, odometry, start, *inertial = generators
        if self._imu is not None:
            self._unit_errors[b] = self._imu.errors(inertial[0])
        self._start_errors[b] = START_SIGMAS[6:] * start.standard_normal(6)
        if self.scenes[b] is not scene:
            self.fleet = with_room(self.fleet, scene)
            self._streams.needed[3] = self.fleet.landmarks.shape[2]
            put_scene(self.fleet, b, scene)
            self.scenes[b] = scene
            if self.bullet is not None:
                self.bullet.build(b, scene.scene)
        choice, noise = landmark.spawn(2)
        if self.rules.noise == NO_NOISE:  # drawn frame by frame, so nothing of it may be drawn ahead
            self._noise_generators[b], noise = noise, np.random.default_rng(0)
        self._streams.begin(self.fleet, b, [motion, odometry, noise, choice])

    def reroute(self, b: int, route: Route) -> None:
        """Let a row follow another route from now on, whose steps are the same up to this frame; the scene stays."""
        scene = self.scenes[b]
        assert scene is not None
        self.scenes[b] = scene = scene._replace(route=route)
        self.fleet = with_room(self.fleet, scene)
        self.fleet.sizes[b, 3] = put_route(self.fleet, b, route)

    def begin(self, chosen: BoolArray) -> None:
        """The first frame of an episode of the chosen rows (B,)."""
        self._run(np.where(chosen, FIRST, WAIT), np.zeros((self.count, 4)))
        self._first_velocities[chosen] = self.fleet.velocity[chosen]

    def step(self, commands: FloatArray, going: BoolArray) -> None:
        """A frame of the rows that go on (B,), by commands (B, n) in -1..1."""
        self._run(np.where(going, STEP, WAIT), commands)

    def sense(self, b: int, ids: IntArray, uvd: FloatArray) -> None:
        """Put what somebody else has measured in the frame of row b into `sensed`."""
        count = self.sensed.number[b] = len(ids)
        self.sensed.ids[b, :count], self.sensed.uvd[b, :count] = ids, uvd
        self.sensed.ids[b, count:] = -1

    def judge(self) -> None:
        """Judge the step after `sense`."""
        self._run_parts(JUDGE)

    def show(self) -> Shown:
        """Frame of all rows, in new arrays."""
        return show(self.rules, self.fleet, self.sensed)

    @property
    def measures_right(self) -> bool:
        """Whether the row in the right image is measured on its own."""
        return self.rules.noise != NOISE_KINDS["uvd"]

    def route(self, b: int) -> Route:
        """The nominal drive of a row; a `RuntimeError` before its first scene."""
        scene = self.scenes[b]
        if scene is None:
            raise RuntimeError("there is no route yet: reset the environment first")
        return scene.route

    def pose(self, b: int) -> Pose:
        """True pose of the left camera of a row."""
        return _pose(self.fleet.pose[b])

    def body(self, b: int) -> Pose:
        """Pose of the left camera of a row if the head looked straight ahead."""
        return self.pose(b) if self.rules.smooth else _pose(self.fleet.body[b])

    def biases(self, b: int) -> FloatArray | None:
        """True biases (6,) of the inertial unit of a row: gyros, rad/s, accelerometers, m/s^2; None without a unit."""
        errors = self._unit_errors[b]
        return None if errors is None else errors.bias

    def frame(self, b: int, seen: StereoObservation | None = None) -> Frame:
        """The frame of a row in full precision; `seen` is what was measured elsewhere."""
        fleet, sensed = self.fleet, self.sensed
        count, step, velocity = int(sensed.number[b]), int(fleet.step[b]), fleet.velocity[b].copy()
        if seen is None:
            right = sensed.v_right[b, :count].copy() if self.measures_right else None
            ids, uvd = sensed.ids[b, :count].copy(), sensed.uvd[b, :count].copy()
            seen = unchecked(StereoObservation, ids=ids, uvd=uvd, v_right=right, R=None, bodies=None)
        linear, angular = sensed.odometry[b, :3].copy(), sensed.odometry[b, 3:].copy()
        odometry = unchecked(BodyVelocity, linear=linear, angular=angular, covariance=self.odometry_covariance)
        return Frame(
            timestamp=step * self.rules.dt,
            observation=seen,
            odometry=odometry if step else None,
            truth=self.pose(b),
            truth_velocity=Velocity(velocity[:3], velocity[3:]),
            head=fleet.angles[b].copy() if self.rules.has_head else None,
            inertial=self._samples(b) if step else None,
            bodies=self._bodies(b, count) if self.rules.room > self.rules.most else None,
        )

    def _bodies(self, b: int, count: int) -> BodyTruth:
        """Moving bodies of a row, and those that its measurements are of."""
        row = slice(b, b + 1)
        numbers = bodies_now(self.fleet, int(self.fleet.sizes[b, 2]), row)[0]
        ids = np.flatnonzero(numbers[:, 0])
        kinds = tuple(BODY_KINDS[int(code) - 1] for code in numbers[ids, 0])
        position, orientation, linear, angular = np.split(numbers[ids, 1:], [3, 7, 10], axis=1)
        labels = bodies_of_measurements(self.fleet, self.sensed, row)[0, :count]
        return BodyTruth(ids, kinds, position, orientation, linear, angular, labels)

    def _samples(self, b: int) -> InertialSamples | None:
        """Samples of the last step of a row; None: there is no unit."""
        if self._imu is None:
            return None
        numbers, h = self.sensed.inertial[b], self.rules.dt / RIDE_STEPS
        times = h * np.arange(1.0, RIDE_STEPS + 1.0)
        return InertialSamples(times, numbers[:, :3].copy(), numbers[:, 3:].copy(), self._imu.unit)

    def start(self, b: int) -> Start:
        """Start of a row as filters are given it: the pose, and the velocity with an error of the covariance."""
        velocity = self._first_velocities[b] + self._start_errors[b]
        return Start(linear_velocity=velocity[:3], angular_velocity=velocity[3:], covariance=np.diag(START_SIGMAS**2))

    def close(self) -> None:
        """Stop threads and engines; may be called at any time, also twice."""
        if self._workers is not None:
            self._workers.shutdown()
        self._workers = None
        if self.bullet is not None:
            self.bullet.close()
            self.scenes = [None] * self.count

    @property
    def nbytes(self) -> int:
        """Memory of the state of all rows."""
        return sum(array.nbytes for array in (*self.fleet, *self.sensed))

    def _run(self, doing: IntArray, commands: FloatArray) -> None:
        self._doing, self._commands = doing, commands
        self._streams.refill(self.fleet, doing != WAIT)
        rest = (SENSE if self._senses else 0) | (JUDGE if self._senses else 0)
        if self.bullet is None:
            self._run_parts(MOVE | rest)
        else:
            self._run_parts(MOVE)
            for b in np.flatnonzero(doing != WAIT).tolist():
                self.bullet.answer(self.rules, self.fleet, self.sensed, b)
            self._run_parts(rest)
        for b in np.flatnonzero(doing != WAIT).tolist() if self._imu is not None else ():
            errors, numbers = self._unit_errors[b], self.sensed.inertial[b]
            assert errors is not None
            numbers[:] = errors.added(numbers, self.rules.dt) if doing[b] == STEP else 0.0
        if self.rules.noise == NO_NOISE and self._senses:
            for b in np.flatnonzero(doing != WAIT).tolist():
                self._corrupt(b)

    def _run_parts(self, parts: int) -> None:
        """Parts of a frame of those that do something."""
        state = self.rules, self.fleet, self.sensed
        if self.threads == 1:
            run_frame(*state, self._rooms[0], self._doing, self._commands, parts, 0, self.count)
            return
        if self._workers is None:
            self._workers = ThreadPoolExecutor(self.threads)
        edges = [self.count * i // self.threads for i in range(self.threads + 1)]
        runs = [
            self._workers.submit(
                lambda *rows: run_frame(*state, *rows), room, self._doing, self._commands, parts, *ends
            )
            for room, *ends in zip(self._rooms, edges[:-1], edges[1:], strict=True)
        ]
        for run in runs:
            run.result()

    def _corrupt(self, b: int) -> None:
        """Noise of a model without a kernel."""
        count, generator = int(self.sensed.number[b]), self._noise_generators[b]
        assert generator is not None
        uvd, v_right = self._noise.corrupt(self.sensed.uvd[b, :count], generator)
        self.sensed.uvd[b, :count] = uvd
        if v_right is not None:
            self.sensed.v_right[b, :count] = v_right


def _pose(numbers: FloatArray) -> Pose:
    return Pose(numbers[:3].copy(), numbers[3:].copy())
