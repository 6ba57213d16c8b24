"""Does the covariance stay a covariance over 100,000 updates? Symmetric, positive definite, no negative variance.

    python benchmarks/covariance_soak.py                                # 6 cases, 20 min on two idle cores
    python benchmarks/covariance_soak.py --updates 5000 --only kept

A camera hovers before 12 landmarks, from 7 m to practically infinity. It starts from a pose known to 1e-6 m and rad
with a velocity known to 1 m/s (variances from 1e-12 to 1), and every 1000 updates it is blind for a second, in
which it may accelerate by 30 m/s^2, so that what is known to a hair sits beside what has been lost: the condition
number of P reaches 1e12. "kept" is one map for ever, measured to ever smaller variances; "turnover" replaces a landmark
in every fifth frame. `--only` takes a part of the names of the cases.

The smallest eigenvalue is that of P scaled to unit variances, looked at every 1000 updates and through the blind
stretches. The six-dimensional form copies one anchor for all landmarks of a frame: its P is singular by construction,
so its smallest eigenvalue is zero to rounding, on either side of it.
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass, field

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from filters import ConstantVelocity, Start, StereoEKF, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.geometry import rotations, symmetric
from harness import arguments, show

LANDMARKS = 12
MOTION = ConstantVelocity(30.0, 0.6)
DT = 0.1
LOOK_EVERY = 1000
BLIND_STEPS = 10
# An anchor starts as a copy of the camera's position, and after one step of Eq. 6 it is r - v dt: P is singular until
# the second.
MOVES_TO_PART = 2
START_SIGMAS = np.repeat([1e-6, 1e-6, 1.0, 0.1], 3)


@dataclass(frozen=True)
class Case:
    """A parametrisation, an error definition, and whether landmarks come and go.

    One map for ever is known to a hair in any case; with turnover it takes a sharper sensor.
    """

    landmark: str
    error: str
    turnover: bool

    @property
    def noise(self) -> StereoNoise:
        """What the sensor has, and the filter assumes."""
        return StereoNoise.independent_pixels(0.1 if self.turnover else 1.0)

    def __str__(self) -> str:
        return f"{self.landmark}, {self.error}, {'turnover' if self.turnover else 'kept'}"


CASES = (
    Case("shared-anchor", "quaternion", turnover=False),
    Case("shared-anchor", "quaternion", turnover=True),
    Case("shared-anchor", "right-invariant", turnover=False),
    Case("euclidean", "quaternion", turnover=False),
    Case("euclidean", "quaternion", turnover=True),
    Case("inverse-depth", "quaternion", turnover=True),
)


@dataclass
class Health:
    """The worst that was seen."""

    smallest_variance: float = np.inf
    smallest_eigenvalue: float = np.inf
    largest_condition: float = 0.0
    asymmetry: float = 0.0
    failed: int = 0
    memory: list[int] = field(default_factory=list)

    def look(self, stereo_filter: StereoEKF) -> None:
        """At the whole covariance."""
        P = symmetric.full(stereo_filter.state.P)
        eigenvalues = np.abs(np.linalg.eigvalsh(P))
        self.largest_condition = max(self.largest_condition, eigenvalues.max() / eigenvalues.min())
        sigmas = np.sqrt(np.diag(P))
        scaled = P / sigmas[:, None] / sigmas
        self.smallest_eigenvalue = min(self.smallest_eigenvalue, float(np.linalg.eigvalsh(scaled)[0]))
        landmarks = stereo_filter.landmarks
        self.smallest_variance = min(self.smallest_variance, landmarks.inverse_distance_variance.min())
        for shown in (stereo_filter.pose.covariance, stereo_filter.velocity.covariance, landmarks.covariances):
            shown = shown[np.isfinite(shown).all(axis=(-2, -1))] if shown.ndim == 3 else shown
            difference = np.abs(shown - np.swapaxes(shown, -1, -2)).max(axis=(-2, -1))
            self.asymmetry = max(self.asymmetry, float((difference / np.abs(shown).max(axis=(-2, -1))).max()))
        self.memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def pose_at(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Hovering within 2 m and 0.15 rad of the origin: position (3,) m and R_wc (3, 3)."""
    position = 2.0 * np.sin(seconds * np.array([0.31, 0.23, 0.17]))
    return position, rotations.exp(0.15 * np.sin(seconds * np.array([0.13, 0.19, 0.29])))


def new_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Before the origin, half of them with less than 3 px of disparity; (count, 3) m."""
    uvd = rng.uniform((300, 80, 3), (1050, 310, 60), (count, 3))
    far = rng.random(count) < 0.5
    uvd[far, 2] = 10.0 ** rng.uniform(-1.0, 0.5, far.sum())
    return CAMERA.backproject(uvd)


def soak(case: Case, updates: int) -> tuple[Health, float, float]:
    """Run it; returns the worst, the RMS position error at the end of the looks in m, and ms per update."""
    rng = np.random.default_rng(0)
    guard = 5.0 if case.landmark == "euclidean" else None
    stereo_filter = StereoEKF(
        CAMERA,
        case.noise,
        motion=MOTION,
        landmark=case.landmark,
        error=case.error,
        gate=0.9999 if case.turnover else None,
        drop_unseen=case.turnover,
        min_disparity=guard,
    )
    position, R_wc = pose_at(0.0)
    stereo_filter.reset(Start(position, covariance=np.diag(START_SIGMAS**2)))
    ids, points = np.arange(LANDMARKS), new_points(rng, LANDMARKS)
    if guard is not None:
        points *= np.minimum(1.0, CAMERA.disparity_constant / (2 * guard) / points[:, 2:])
    health, errors = Health(), []
    now, spent, moves = 0.0, 0.0, 0
    for k in range(updates):
        if k and k % LOOK_EVERY == 0:
            for _ in range(BLIND_STEPS):
                stereo_filter.predict(DT)
                now += DT
                moves += 1
            health.look(stereo_filter)
        if case.turnover and k % 5 == 4:
            out = rng.integers(LANDMARKS)
            ids[out], points[out] = ids.max() + 1, new_points(rng, 1)[0]
            if guard is not None:
                points[out] *= min(1.0, CAMERA.disparity_constant / (2 * guard) / points[out, 2])
        now += DT
        position, R_wc = pose_at(now)
        uvd = CAMERA.project((points - position) @ R_wc) + rng.multivariate_normal(np.zeros(3), case.noise.R, LANDMARKS)
        order = np.argsort(ids)
        observation = StereoObservation(ids[order], uvd[order])
        began = time.perf_counter()
        stereo_filter.predict(DT)
        report = stereo_filter.update(observation)
        spent += time.perf_counter() - began
        state = stereo_filter.state
        health.failed += report.failed_factorisations
        health.smallest_variance = min(health.smallest_variance, float(np.diagonal(state.P).min()))
        moves = 0 if len(report.initialised) else moves + 1
        if (k % LOOK_EVERY == 0 or k < 20) and moves >= MOVES_TO_PART:
            health.look(stereo_filter)
            errors.append(np.linalg.norm(stereo_filter.pose.position - position))
    return health, float(np.sqrt(np.mean(np.square(errors)))), 1e3 * spent / updates


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, updates=100_000, jobs=2, only="")
    cases = [case for case in CASES if given.only in str(case)]
    with threadpool_limits(1):
        results = Parallel(given.jobs)(delayed(soak)(case, given.updates) for case in cases)
    heads = ("case", "smallest eigenvalue, scaled", "smallest variance", "condition of P", "asymmetry", "failed")
    rows = []
    for case, (health, error, milliseconds) in zip(cases, results, strict=True):
        # The first tenth fills caches and pools.
        grown = (health.memory[-1] - health.memory[len(health.memory) // 10]) / 1024
        worst = (health.smallest_eigenvalue, health.smallest_variance, health.largest_condition, health.asymmetry)
        last = (str(health.failed), f"{grown:.1f}", f"{error:.3f}", f"{milliseconds:.2f}")
        rows.append((str(case), *(f"{value:.1e}" for value in worst), *last))
    title = f"{given.updates} updates of {LANDMARKS} landmarks, the worst seen"
    show(title, (*heads, "memory grown MB", "position rms m", "ms"), rows)


if __name__ == "__main__":
    main()
