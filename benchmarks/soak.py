"""A filter and an environment that run for very long: what they hold, how fast they are, whether they stay sound.

    python benchmarks/soak.py                                         # 1,000,000 updates and 100,000 steps
    python benchmarks/soak.py --updates 20000 --steps 2000            # some minutes
    python benchmarks/soak.py --updates 0 --env StereoSlam/Gaze-v0
    python benchmarks/soak.py --steps 0 --filter right-invariant

The filter hovers before 12 landmarks; every fifth frame one of them goes and a new one, with a new id, comes. The
environment takes random actions; an episode that ends is followed by the next seed. Both are looked at a hundred times
on the way: resident memory after a garbage collection, and the invariants.

The slope of the memory is that of a straight line through all but the first tenth. In a short run it says nothing: the
world keeps the last 64 streets, and their cache is still filling. The slow-down is the processor time of the last tenth
over that of the second; because the machine may have other work, the filter is also timed beside a fresh one, frame by
frame on the same frames, at the end.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from rich.progress import track
from threadpoolctl import threadpool_limits

import stereo_slam_env  # noqa: F401 (registers the environments)
from filters import ConstantVelocity, Start, StereoFilter, StereoNoise, StereoObservation, make_filter
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.geometry import rotations
from harness import arguments, resident_megabytes, show

LOOKS, LANDMARKS, TURNOVER, DT = 100, 12, 5, 0.1
NOISE, MOTION = StereoNoise.independent_pixels(0.5), ConstantVelocity(1.0, 0.6)
CHEAP = {"route": "right-turn", "policy": "route", "rig": "qvga"}
SLOPE_WANTED, SLOWER_WANTED = 1.0, 1.05
"""MB per 100,000, and the most that the end may take of the beginning."""


@dataclass
class Log:
    """What was seen, look by look."""

    done: list[int] = field(default_factory=list)
    """Updates or steps before each look."""
    held: list[float] = field(default_factory=list)
    """MB."""
    seconds: list[float] = field(default_factory=list)
    """Processor time since the look before."""
    worst: dict[str, float] = field(default_factory=dict)
    """The worst of each invariant."""

    def note(self, **invariants: float) -> None:
        """Keep the largest of each."""
        for name, value in invariants.items():
            self.worst[name] = float(np.maximum(value, self.worst.get(name, -np.inf)))  # NaN stays

    @property
    def slope(self) -> float:
        """MB per 100,000, after the first tenth."""
        start = len(self.done) // 10
        return 1e5 * float(np.polyfit(self.done[start:], self.held[start:], 1)[0])

    @property
    def slower(self) -> float:
        """Processor time of the last tenth of the looks over that of the second, by their medians."""
        tenth = max(1, len(self.seconds) // 10)
        return float(np.median(self.seconds[-tenth:]) / np.median(self.seconds[tenth : 2 * tenth]))


def run(log: Log, count: int, step: Callable[[], None], look: Callable[[], None], what: str) -> None:
    """Take `count` steps with a look after each hundredth part."""
    each = max(1, count // LOOKS)
    for done in track(range(each, count + 1, each), what):
        began = time.process_time()
        for _ in range(each):
            step()
        log.seconds.append(time.process_time() - began)
        look()
        log.done.append(done)
        log.held.append(resident_megabytes())


class World:
    """A camera that hovers before landmarks that come and go."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._frames = 0
        self._ids = np.arange(LANDMARKS)
        self._p_w = self._new_points(LANDMARKS)
        self._root = np.linalg.cholesky(NOISE.R)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Where it is: position (3,) m and R_wc (3, 3), within 2 m and 0.15 rad of the origin."""
        seconds = DT * self._frames
        position = 2.0 * np.sin(seconds * np.array([0.31, 0.23, 0.17]))
        return position, rotations.exp(0.15 * np.sin(seconds * np.array([0.13, 0.19, 0.29])))

    def next_view(self) -> StereoObservation:
        """What is seen a frame later."""
        self._frames += 1
        if self._frames % TURNOVER == 0:  # the oldest goes, so that ids stay in order
            self._ids = np.append(self._ids[1:], self._ids[-1] + 1)
            self._p_w = np.vstack([self._p_w[1:], self._new_points(1)])
        position, R_wc = self.pose()
        errors = self._rng.standard_normal((LANDMARKS, 3)) @ self._root.T
        return StereoObservation(self._ids, CAMERA.project((self._p_w - position) @ R_wc) + errors)

    def _new_points(self, count: int) -> np.ndarray:
        return CAMERA.backproject(self._rng.uniform((300, 80, 5), (1050, 310, 60), (count, 3)))


def soak_filter(name: str, updates: int, options: dict[str, Any] | None = None) -> tuple[Log, float]:
    """Update a filter so often; also the median of its time per frame over that of a fresh one, at the end."""
    log, world = Log(), World()

    def made() -> StereoFilter:
        slam = make_filter(name, camera=CAMERA, noise=NOISE, motion=MOTION, **(options or {}))
        position, R_wc = world.pose()
        slam.reset(Start(position, rotations.from_matrix(R_wc)))
        return slam

    def step() -> None:
        slam.predict(DT)
        slam.update(world.next_view())

    def look() -> None:
        pose, velocity, landmarks = slam.pose, slam.velocity, slam.landmarks
        log.note(quaternion_off_unit=abs(np.linalg.norm(pose.orientation) - 1.0))
        for P in (pose.covariance, velocity.covariance, *landmarks.covariances):
            sigmas = np.sqrt(np.diag(P))
            scaled = P / sigmas[:, None] / sigmas
            # NaN, from a variance below zero, too, stays the worst.
            log.note(
                asymmetry=float(np.abs(scaled - scaled.T).max()),
                lack_of_definiteness=-float(np.linalg.eigvalsh(scaled)[0]) if np.isfinite(scaled).all() else np.nan,
            )
        log.note(landmarks=float(len(landmarks.ids)))

    with threadpool_limits(1):
        slam = made()
        run(log, updates, step, look, f"updates of {name}")
        both = slam, made()
        times = np.zeros((max(50, min(2000, updates // 10)), 2))
        for k in range(len(times)):
            view = world.next_view()
            for which in (0, 1) if k % 2 else (1, 0):
                began = time.perf_counter()
                both[which].predict(DT)
                both[which].update(view)
                times[k, which] = time.perf_counter() - began
    aged, fresh = np.median(times[len(times) // 10 :], axis=0)
    return log, float(aged / fresh)


def soak_environment(name: str, arguments: dict[str, Any], steps: int) -> Log:
    """Step an environment so often, with random actions."""
    log = Log()
    env = gym.make(name, disable_env_checker=True, **arguments)
    env.action_space.seed(0)
    state = {"seed": 0, "over": False}
    last: list[Any] = [*env.reset(seed=0), 0.0]

    def step() -> None:
        if state["over"]:
            state["seed"] += 1
            last[:2] = env.reset(seed=state["seed"])
        last[0], last[2], terminated, truncated, last[1] = env.step(env.action_space.sample())
        state["over"] = terminated or truncated

    def look() -> None:
        observation, info, reward = last
        truth = {key: np.asarray(value) for key, value in info.items() if key.startswith("truth_")}
        log.note(
            quaternion_off_unit=abs(np.linalg.norm(truth["truth_orientation"]) - 1.0),
            outside_of_its_space=float(not env.observation_space.contains(observation)),
            not_finite=float(not np.isfinite([reward, *(np.isfinite(v).all() for v in truth.values())]).all()),
            episodes=float(state["seed"] + 1),
        )

    try:
        with threadpool_limits(1):
            run(log, steps, step, look, f"steps of {name}")
    finally:
        env.close()
    return log


def report(title: str, log: Log, beside_fresh: float | None) -> None:
    """Print ten looks and the verdict."""
    each = log.done[0]
    rows = [
        (f"{log.done[k]:,}", f"{log.held[k]:.1f}", f"{1e3 * log.seconds[k] / each:.3f}")
        for k in np.unique(np.linspace(0, len(log.done) - 1, 11).astype(int))
    ]
    show(title, ("done", "process, MB", "ms each"), rows)
    print(f"memory: {log.slope:+.3f} MB per 100,000 ({verdict(log.slope < SLOPE_WANTED)})")
    print(f"last tenth against the second, processor time: x {log.slower:.3f}")
    if beside_fresh is not None:
        print(f"beside a fresh one, frame by frame: x {beside_fresh:.3f} ({verdict(beside_fresh < SLOWER_WANTED)})")
    print("worst: " + ", ".join(f"{name.replace('_', ' ')} {value:.2g}" for name, value in log.worst.items()))


def verdict(met: bool) -> str:
    """In words."""
    return "met" if met else "not met"


def main() -> None:
    """Run and print."""
    given = arguments(
        __doc__,
        updates=1_000_000,
        filter="shared-anchor",
        options={},
        steps=100_000,
        env="StereoSlam/Drive-v0",
        kwargs=CHEAP,
    )
    if given.updates:
        log, beside_fresh = soak_filter(given.filter, given.updates, given.options)
        report(f"{given.updates:,} updates of {given.filter}", log, beside_fresh)
    if given.steps:
        log = soak_environment(given.env, given.kwargs, given.steps)
        report(f"{given.steps:,} steps of {given.env} {json.dumps(given.kwargs)}", log, None)


if __name__ == "__main__":
    main()
