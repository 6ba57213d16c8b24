"""A short drive along a street on which bodies with landmarks move: what is true, and what the camera sees."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filters import BodiesBelief, Start, StereoEKF, StereoNoise, StereoObservation
from filters.geometry import rotations
from filters.geometry.poses import Pose, relative_jacobian

from ..drives import CAMERA, DT

NOISE = StereoNoise.independent_pixels(0.5)
SPEED = 6.0


@dataclass(frozen=True)
class Mover:
    """A body that keeps its twist: where it starts, its speed along its own z axis, its rate of turn about y."""

    position: tuple[float, float, float] = (3.0, 1.0, 22.0)
    heading: float = 0.0
    speed: float = 5.0
    turn: float = 0.0
    size: tuple[float, float, float] = (1.8, 1.4, 4.0)
    count: int = 12

    def pose(self, time: float) -> Pose:
        """Of its axes in W."""
        start = Pose(np.array(self.position), rotations.exp_quaternion([0.0, self.heading, 0.0]))
        return start @ Pose.exp(time * np.array([0.0, 0.0, self.speed, 0.0, self.turn, 0.0]))

    def twist(self, time: float, point_w: np.ndarray) -> np.ndarray:
        """Velocity of a point that moves with it, and angular velocity, in W."""
        pose, spin = self.pose(time), np.array([0.0, self.turn, 0.0])
        linear = pose.R_wc @ [0.0, 0.0, self.speed] + np.cross(spin, point_w - pose.position)
        return np.concatenate([linear, spin])


CARS = (Mover(), Mover((-4.0, 1.0, 45.0), np.pi, 4.0, 0.02), Mover((0.5, 1.0, 30.0), 0.0, 7.0, -0.03))
WALKERS = (Mover((4.0, 0.8, 25.0), 1.4, 1.4, size=(0.5, 1.7, 0.4), count=7),)


@dataclass(frozen=True)
class Sight:
    """One frame: the pose of the camera, the measurements, with the mover of each (-1: none)."""

    camera: Pose
    observation: StereoObservation


def street(seed: int, movers: tuple[Mover, ...] = CARS, frames: int = 50, standing: int = 60) -> list[Sight]:
    """Drive straight on between points on both sides; new ones take the places of those that leave the view."""
    rng = np.random.default_rng([17, seed])
    on_bodies = [(rng.random((m.count, 3)) - 0.5) * m.size for m in movers]
    points, newest, seen = {}, 0, []
    for k in range(frames):
        camera = Pose(np.array([0.0, 0.0, SPEED * DT * k]))
        points = {i: p for i, p in points.items() if _seen(camera, p[None])[0]}
        while len(points) < standing:
            depth = rng.uniform(8.0, 60.0) if k == 0 else rng.uniform(30.0, 60.0)
            p = camera @ np.array([rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 12.0), rng.uniform(-3.0, 1.5), depth])
            newest += 1
            if _seen(camera, p[None])[0]:
                points[newest] = p
        ids, positions, labels = list(points), list(points.values()), [-1] * len(points)
        for m, (mover, local) in enumerate(zip(movers, on_bodies, strict=True)):
            world = np.array([mover.pose(k * DT) @ p for p in local])
            for i in np.flatnonzero(_seen(camera, world)).tolist():
                ids.append(10**6 * (m + 1) + i)
                positions.append(world[i])
                labels.append(m)
        uvd = CAMERA.project(camera.to_camera(np.array(positions)))
        uvd = uvd + rng.multivariate_normal(np.zeros(3), NOISE.R, len(ids))
        seen.append(Sight(camera, StereoObservation(ids, uvd, bodies=np.array(labels))))
    return seen


def _seen(camera: Pose, points: np.ndarray) -> np.ndarray:
    points_c = camera.to_camera(points)
    ahead = points_c[:, 2] > 3.0
    points_c[~ahead] = [0.0, 0.0, 3.0]
    return ahead & (points_c[:, 2] < 60.0) & CAMERA.in_view(CAMERA.project(points_c), margin=3.0)


@dataclass
class Score:
    """Errors of a filter on one drive."""

    ego: list[float] = field(default_factory=list)
    """Position of the camera, m."""
    pose: list[float] = field(default_factory=list)
    """NEES / 6 of the pose of bodies relative to the camera, as moved since their birth."""
    twist: list[float] = field(default_factory=list)
    """NEES / 6 of velocity and angular velocity."""
    speed: list[float] = field(default_factory=list)
    """Speed errors, m/s."""
    wrong: int = 0
    """Landmarks on a body other than their own, or of the scene on one, over the frames."""
    born: int = 0
    mover_as_static: int = 0
    on_movers: int = 0


def drive_along(
    slam: StereoEKF, seen: list[Sight], movers: tuple[Mover, ...], *, told: bool, oldest: int = 10
) -> Score:
    """Run a filter and score it: bodies that are `oldest` frames old or more."""
    slam.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=np.diag(np.repeat([1e-4, 1e-4, 0.3, 0.03], 3) ** 2)))
    score, births = Score(), {}
    for k, sight in enumerate(seen):
        if k:
            slam.predict(DT)
        observation, mover_of = (
            sight.observation,
            dict(zip(sight.observation.ids.tolist(), sight.observation.bodies, strict=True)),
        )
        if not told:
            observation = StereoObservation(observation.ids, observation.uvd)
        report = slam.update(observation)
        score.ego.append(float(np.linalg.norm(slam.pose.position - sight.camera.position)))
        belief = slam.bodies
        score.born += len(report.born)
        for j, number in enumerate(belief.ids.tolist()):
            own = np.array([mover_of.get(i, -9) for i in belief.landmarks[j].tolist()])
            if number not in births:
                births[number] = [k, None, sight.camera, _pose_of(slam).inverse() @ _body_of(belief, j)]
            if births[number][1] is None and (own >= 0).any():
                births[number][1] = int(np.bincount(own[own >= 0]).argmax())
            mover = births[number][1]
            score.wrong += int((own != mover).sum()) if mover is not None else 0
            if mover is not None and len(own) and k - births[number][0] >= oldest:
                _score_body(score, slam, belief, j, movers[mover], births[number], k, sight.camera)
        on_body = np.concatenate([np.zeros(0, np.int64), *belief.landmarks])
        if k > 10:
            used = report.updated[~np.isin(report.updated, on_body)]
            score.mover_as_static += sum(mover_of[i] >= 0 for i in used.tolist())
            score.on_movers += sum(m >= 0 for m in mover_of.values())
    return score


def _pose_of(slam: StereoEKF) -> Pose:
    return Pose(slam.pose.position, slam.pose.orientation)


def _body_of(belief: BodiesBelief, j: int) -> Pose:
    return Pose(belief.positions[j], belief.orientations[j])


def _score_body(
    score: Score, slam: StereoEKF, belief: BodiesBelief, j: int, mover: Mover, birth: list, k: int, camera: Pose
) -> None:
    """The true body is what the first belief of it, seen from the true camera, has become since."""
    first, _, camera_then, from_camera = birth
    true_body = mover.pose(k * DT) @ mover.pose(first * DT).inverse() @ camera_then @ from_camera
    name = f"body-{belief.ids[j]}"
    joint = slam.belief("pose", name).covariance
    estimate, J = _pose_of(slam).inverse() @ _body_of(belief, j), relative_jacobian(_pose_of(slam), _body_of(belief, j))
    truth = camera.inverse() @ true_body
    e = np.concatenate([truth.position - estimate.position, rotations.log(estimate.R_wc.T @ truth.R_wc)])
    S = J @ joint[:12, :12] @ J.T + 1e-12 * np.eye(6)
    twist = mover.twist(k * DT, true_body.position) - np.concatenate([belief.linear[j], belief.angular[j]])
    score.pose.append(float(e @ np.linalg.solve(S, e)) / 6)
    score.twist.append(float(twist @ np.linalg.solve(joint[12:, 12:], twist)) / 6)
    score.speed.append(float(np.linalg.norm(belief.linear[j]) - mover.speed))
