"""The claims of speed: one update with (u, v, d) against two with bearings, over sizes of the map.

Landmarks enter a hundred a frame, and at most the last hundred stay in view; the others stay in the map. The filters
are timed in turns in one process with one BLAS thread, and each round gives one ratio. What is measured is processor
time, so that a busy machine does as little harm as possible.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from filters import (
    LeftThenRight,
    RangeBearing,
    Stacked,
    Start,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    make_filter,
)
from stereo_slam_env.paper.paper_claims import (
    DUAL,
    EUCLIDEAN,
    FILTER_NAMES,
    FILTERS,
    JOINT,
    PAZ,
    SENTENCES,
    Arrays,
    Claim,
    ClaimFinding,
    FloatArray,
    Interval,
    Measured,
    Range,
    claim,
    ratio_interval,
)
from stereo_slam_env.sensing import RIGS

CAMERA = RIGS["reference"]
NOISE = StereoNoise.independent_pixels(1.0)


FORMS: Mapping[str, dict[str, Any]] = {
    "6-D, as in the paper": {"landmark": "inverse-depth"},
    "shared anchors": {"landmark": "shared-anchor"},
}
"""How landmarks are stored by the paper's filter and by that with two bearing updates."""
RIVALS: Mapping[str, tuple[str, ...]] = dict(zip(FORMS, ((DUAL,), (DUAL, PAZ)), strict=True))
"""Competitors of the same form; our Paz et al. shares anchors until a landmark becomes XYZ."""
XYZ = f"points.{EUCLIDEAN}"
IN_VIEW = 100
"""Landmarks of a frame at most."""
LARGE = 500
"""Landmarks from which on a map counts as large; there, rounds are fewer and a frame long."""
DT, SPEED = 0.1, 0.05
"""s, m/s: so slow that every landmark stays in view."""
BURST = 3
"""Frames of one filter in a row: in use it does not share the processor's caches with its competitor."""
PREDICTIONS = 20
"""Predictions in a row, timed together."""
FEWEST = 8
"""Rounds at least: an interval needs so many."""
Times = Mapping[str, FloatArray]
"""Milliseconds a frame in each round, by "form.filter.predict" and "form.filter.both"."""


class SlowDrive:
    """A filter on a slow drive towards n points, of which it sees the last hundred in every frame."""

    def __init__(self, n: int, slam: StereoFilter) -> None:
        self._rng = np.random.default_rng(n)
        low, high = (400.0, 100.0, 5.0), (900.0, 300.0, 40.0)
        self._points, self._frame, self._slam = CAMERA.backproject(self._rng.uniform(low, high, (n, 3))), 0, slam
        slam.reset(Start(linear_velocity=np.array([0.0, 0.0, SPEED])))
        ends = [*range(IN_VIEW, n, IN_VIEW), n] if n > IN_VIEW else [n * tenth // 10 for tenth in range(1, 11)]
        for end in ends:
            self._view = slice(max(end - IN_VIEW, 0), end)
            slam.update(self._observe())
            slam.predict(DT)
            self._frame += 1

    def milliseconds(self, burst: int) -> float:
        """Mean processor time of predict + update over some frames."""
        elapsed = 0.0
        for _ in range(burst):
            self._frame += 1
            observation = self._observe()
            began = time.process_time()
            self._slam.predict(DT)
            self._slam.update(observation)
            elapsed += time.process_time() - began
        return 1000.0 * elapsed / burst

    def milliseconds_of_predict(self, count: int) -> float:
        """Mean processor time of a prediction, of so many in a row: one alone is shorter than the clock is fine."""
        began = time.process_time()
        for _ in range(count):
            self._slam.predict(DT)
        return 1000.0 * (time.process_time() - began) / count

    def _observe(self) -> StereoObservation:
        ids = np.arange(len(self._points))[self._view]
        uvd = CAMERA.project(self._points[self._view] - (0.0, 0.0, SPEED * DT * self._frame))
        return StereoObservation(ids, uvd + self._rng.multivariate_normal(np.zeros(3), NOISE.R, len(ids)))


def experiments(sizes: Sequence[int], repeats: int) -> dict[str, partial[Arrays]]:
    """One for each size of the map; each needs the machine for itself."""
    return {f"speed-{n:04d}": partial(timed, n, repeats) for n in sizes}


def contestants() -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Name in results, filter, and its options."""
    for form, options in FORMS.items():
        for name in (JOINT, *RIVALS[form]):
            yield (
                f"{form}.{name}",
                FILTERS[name][0],
                FILTERS[name][1] if name == PAZ else {**options, **FILTERS[name][1]},
            )
    yield XYZ, *FILTERS[EUCLIDEAN]


def timed(n: int, repeats: int) -> Arrays:
    """Milliseconds of each contestant in each round, at n landmarks in the map."""
    rounds, burst = (repeats, BURST) if n < LARGE else (max(repeats * 100 // n, FEWEST), 1)
    times: dict[str, FloatArray] = {}
    drives = {
        name: SlowDrive(n, make_filter(kind, camera=CAMERA, noise=NOISE, gate=None, drop_unseen=False, **options))
        for name, kind, options in contestants()
    }
    for number in range(-1, rounds):
        for name, drive in drives.items():
            measured = drive.milliseconds(burst)
            if number >= 0:  # what is done once is no part of a frame
                times.setdefault(f"{name}.both", np.zeros(rounds))[number] = measured
    for name, drive in drives.items():
        times[f"{name}.predict"] = np.array([drive.milliseconds_of_predict(PREDICTIONS) for _ in range(repeats)])
    return times


def milliseconds(results: Mapping[str, Arrays]) -> dict[int, Times]:
    """Times by size of the map."""
    arrays_by_size = {
        int(name.removeprefix("speed-")): arrays for name, arrays in results.items() if name.startswith("speed-")
    }
    return dict(sorted(arrays_by_size.items()))


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of speed, and those of the two models of an update that need no drive."""
    measured = milliseconds(results)

    def faster(*, large: bool) -> Measured:
        for form in FORMS:
            for rival in RIVALS[form]:
                for n, times in measured.items():
                    if (n >= LARGE) == large:
                        about = {"state": form, "competitor": FILTER_NAMES[rival], "landmarks": str(n)}
                        yield about, ratio_interval(times[f"{form}.{JOINT}.both"], times[f"{form}.{rival}.both"])

    six_numbers = next(iter(FORMS))
    intensive = [
        ({"landmarks": str(n)}, ratio_interval(times[f"{six_numbers}.{JOINT}.both"], times[f"{XYZ}.both"]))
        for n, times in measured.items()
    ]
    return (
        claim("linear-prediction", growth_of_prediction(measured)),
        claim("six-numbers", intensive),
        claim("faster", faster(large=False)),
        claim("faster-large", faster(large=True)),
        _counted(),
        claim(
            "no-range", [({"measurement": words}, Interval(*[gap] * 3)) for words, gap in information_gaps().items()]
        ),
    )


def growth_of_prediction(measured: Mapping[int, Times]) -> Measured:
    """Exponent of the time of a prediction by the number of landmarks, from a quarter of the largest map to all."""
    last = max(measured)
    first = min(measured, key=lambda n: abs(n - last / 4))
    for form in FORMS:
        name = f"{form}.{JOINT}.predict"
        ratio = ratio_interval(measured[last][name], measured[first][name])
        with np.errstate(invalid="ignore"):
            exponents = np.log([ratio.value, ratio.low, ratio.high]) / np.log(last / first)
        yield {"state": form, "landmarks": f"{first} to {last}"}, Interval(*exponents.tolist())


def _counted() -> Claim:
    """Number of updates a frame, counted in the measurement models."""
    observation = StereoObservation(np.arange(1), np.array([[600.0, 200.0, 10.0]]))
    counted = []
    for name, model, expected_count in (("ours", RangeBearing(), 1), ("competitor", LeftThenRight(), 2)):
        count = len(model.stages(observation, NOISE.R[None]))
        counted.append(
            ClaimFinding({"filter": name}, Interval(count, count, count), Range(expected_count, expected_count))
        )
    return Claim(SENTENCES["one-update"], tuple(counted))


def information_gaps() -> dict[str, float]:
    """Relative difference of the information of (u, v, d) and of the two bearings, for the same R.

    With y = T z for the rows (u, v) and u_right = u - d of the two images, the bearings have the covariance T R T^T,
    and H^T R^-1 H is the same for both: T is invertible. It holds for any H, so also for depth.
    """
    observation = StereoObservation(np.arange(1), np.array([[600.0, 200.0, 10.0]]))
    H = np.random.default_rng(0).standard_normal((3, 9))  # rows of u, v, d by nine numbers of a state

    def information(model: RangeBearing | LeftThenRight | Stacked, R: FloatArray) -> FloatArray:
        stages = model.stages(observation, R[None])
        rows = [(stage.T @ H, stage.R[0]) for stage in stages]
        return np.asarray(sum(by_state.T @ np.linalg.solve(noise, by_state) for by_state, noise in rows))

    gaps = {}
    cases = (
        ("left, then right; R of independent pixels", LeftThenRight(), NOISE.R),
        ("both at once; R of independent pixels", Stacked(), NOISE.R),
        ("both at once; the paper's R", Stacked(), np.eye(3)),
    )
    for words, model, R in cases:
        ours = information(RangeBearing(), R)
        gaps[words] = float(np.abs(information(model, R) - ours).max() / np.abs(ours).max())
    return gaps
