"""Our filter against what else solves the problem, per frame of a drive where landmarks leave and enter all the time.

    python benchmarks/rival_speed.py                   # 100 landmarks in view, one minute; needs gtsam
    python benchmarks/rival_speed.py --landmarks 50 --frames 60

The drive is straight, at 4.9 m/s. What a user needs of a frame is the pose and its covariance. Our filter has both
after predict + update. GTSAM's iSAM2 (default settings) is timed for the update alone; with the making of the factors
and the estimate of the pose; and with the marginal covariance of the pose, too, which is what our filter gives. It is
a smoother and keeps every landmark it has seen, as such a map does. filterpy's EKF gets H, and the landmarks are not
even replaced: only predict + update at the size of the state a user would write, six numbers a landmark. All run in
turns on the same measurements, after 50 frames, with one BLAS thread; processor time, 20 % quantile.
"""

from __future__ import annotations

import time

import numpy as np
from threadpoolctl import threadpool_limits

from filter_speed import filterpy_step
from filters import Start, StereoEKF, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from harness import arguments, show, undisturbed

try:
    import gtsam
    from gtsam.symbol_shorthand import L, X
except ImportError:
    gtsam = None

NOISE = StereoNoise.independent_pixels(1.0)
DT, SPEED, WARM_UP = 0.1, 4.9, 50
NEAR, FAR = 4.0, 60.0
SLOW_FRAMES = 8  # of filterpy


class Street:
    """Points ahead of a camera that drives straight on; one that leaves the view is replaced by a new one."""

    def __init__(self, visible: int) -> None:
        self.rng, self.frame, self.next_id = np.random.default_rng(visible), -1, 0
        self.visible = visible
        self.ids, self.points = np.zeros(0, dtype=np.int64), np.zeros((0, 3))

    def observe(self) -> StereoObservation:
        """The next frame."""
        self.frame += 1
        p_c = self.points - (0.0, 0.0, SPEED * DT * self.frame)
        seen = p_c[:, 2] > NEAR
        seen[seen] = CAMERA.in_view(CAMERA.project(p_c[seen]), 5.0)
        missing = self.visible - int(seen.sum())
        depth = self.rng.uniform(NEAR + 2.0, FAR, missing)
        u, v = self.rng.uniform((150, 30), (1200, 360), (missing, 2)).T
        new = CAMERA.backproject(np.column_stack([u, v, CAMERA.disparity_constant / depth]))
        self.points = np.vstack([self.points[seen], new + np.array([0.0, 0.0, SPEED * DT * self.frame])])
        self.ids = np.concatenate([self.ids[seen], self.next_id + np.arange(missing)])
        self.next_id += missing
        p_c = self.points - (0.0, 0.0, SPEED * DT * self.frame)
        errors = self.rng.multivariate_normal(np.zeros(3), NOISE.R, self.visible)
        return StereoObservation(self.ids, CAMERA.project(p_c) + errors)


class Ours:
    """`StereoEKF`."""

    def __init__(self, **options: object) -> None:
        self.slam = StereoEKF(CAMERA, NOISE, **options)  # type: ignore[arg-type]
        self.slam.reset(Start(linear_velocity=(0, 0, SPEED)))

    def step(self, observation: StereoObservation) -> dict[str, float]:
        """Do a frame; the seconds of processor that it took."""
        began = time.process_time()
        self.slam.predict(DT)
        report = self.slam.update(observation)
        pose = self.slam.pose
        elapsed = time.process_time() - began
        assert np.isfinite(pose.covariance).all()
        assert len(report.gated) < 0.2 * len(observation)
        return {"": elapsed}


class Isam2:
    """GTSAM's iSAM2 with stereo factors and a motion factor between poses."""

    def __init__(self) -> None:
        self.isam, self.frame, self.known = gtsam.ISAM2(), 0, set[int]()
        self.K = gtsam.Cal3_S2Stereo(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy, CAMERA.baseline)
        self.pixels = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
        self.motion = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.03, 0.1], 3))
        self.start = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
        self.ahead = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, SPEED * DT]))
        self.pose = gtsam.Pose3()

    def step(self, observation: StereoObservation) -> dict[str, float]:
        """Do a frame; the seconds of processor that it took."""
        began = time.process_time()
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if self.frame == 0:
            graph.add(gtsam.PriorFactorPose3(X(0), self.pose, self.start))
        else:
            self.pose = self.pose.compose(self.ahead)
            graph.add(gtsam.BetweenFactorPose3(X(self.frame - 1), X(self.frame), self.ahead, self.motion))
        values.insert(X(self.frame), self.pose)
        points = CAMERA.backproject(np.maximum(observation.uvd, (-np.inf, -np.inf, 1.0)))
        for i, (u, v, d), p_c in zip(observation.ids.tolist(), observation.uvd.tolist(), points, strict=True):
            graph.add(
                gtsam.GenericStereoFactor3D(gtsam.StereoPoint2(u, u - d, v), self.pixels, X(self.frame), L(i), self.K)
            )
            if i not in self.known:
                self.known.add(i)
                values.insert(L(i), self.pose.transformFrom(p_c))
        made = time.process_time()
        self.isam.update(graph, values)
        updated = time.process_time()
        self.pose = self.isam.calculateEstimatePose3(X(self.frame))
        located = time.process_time()
        covariance = self.isam.marginalCovariance(X(self.frame))
        done = time.process_time()
        assert np.isfinite(covariance).all()
        self.frame += 1
        return {
            ", update alone": updated - made,
            ", factors, update, pose": located - began,
            ", factors, update, pose, covariance": done - began,
        }


def measure(landmarks: int, frames: int) -> tuple[dict[str, float], float]:
    """Seconds a frame of everything, and how many landmarks enter in a frame."""
    street = Street(landmarks)
    steps = {"shared anchors": Ours(landmark="shared-anchor").step}
    steps["6-D"] = Ours(landmark="inverse-depth").step
    if gtsam is not None:
        steps["GTSAM iSAM2"] = Isam2().step
    filterpy = filterpy_step(3 * landmarks, 12 + 6 * landmarks)
    times: dict[str, list[float]] = {}
    entered = []
    for frame in range(WARM_UP + frames):
        before = street.next_id
        observation = street.observe()
        entered.append(street.next_id - before)
        for name, step in steps.items():
            for part, seconds in step(observation).items():
                times.setdefault(name + part, []).append(seconds)
        if WARM_UP <= frame < WARM_UP + SLOW_FRAMES:
            times.setdefault("filterpy EKF, 6-D state", [0.0] * WARM_UP).append(filterpy())
    return {name: undisturbed(t[WARM_UP:]) for name, t in times.items()}, float(np.mean(entered[WARM_UP:]))


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, landmarks=100, frames=60)
    with threadpool_limits(1):
        taken, entering = measure(given.landmarks, given.frames)
    ours = {name: s for name, s in taken.items() if name.startswith("shared anchors")}
    rows = [(name, f"{1e3 * s:.2f}", *(f"{s / own:.2f}" for own in ours.values())) for name, s in taken.items()]
    title = f"a frame with {given.landmarks} landmarks in view, {entering:.1f} of them new"
    show(title, ("", "ms", *(f"times {name}" for name in ours)), rows)


if __name__ == "__main__":
    main()
