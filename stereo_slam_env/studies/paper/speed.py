"""The claim of speed: one update with (u, v, d) against two with bearings, over sizes of the map.

All n landmarks are seen in every frame. The filters are timed in turns in one process with one BLAS thread, and each
round gives one ratio. What is measured is processor time, so that a busy machine does as little harm as possible.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from filters import (
    LeftThenRight,
    RangeBearing,
    Start,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    make_filter,
)
from stereo_slam_env.sensing import RIGS
from stereo_slam_env.studies.paper.claims import (
    DUAL,
    JOINT,
    SENTENCES,
    Arrays,
    Claim,
    ClaimFinding,
    FloatArray,
    Interval,
    Range,
    claim,
    ratio_interval,
)

CAMERA = RIGS["reference"]
NOISE = StereoNoise.independent_pixels(1.0)
FORMS: Mapping[str, Mapping[str, Any]] = {
    "6-D, as in the paper": {"landmark": "inverse-depth"},
    "shared anchors": {"landmark": "shared-anchor"},
}
"""How the state is stored; the same for both filters."""
GROUPS = 10
"""Frames in which the landmarks enter the map."""
DT, SPEED = 0.1, 0.05
"""s, m/s: so slow that every landmark stays in view."""
BURST = 3
"""Frames of one filter in a row: in use it does not share the processor's caches with its competitor."""


class SlowDrive:
    """A filter on a slow drive towards n points that it sees in every frame."""

    def __init__(self, n: int, filter_name: str, options: Mapping[str, Any]) -> None:
        rng = np.random.default_rng(n)
        low, high = (400.0, 100.0, 5.0), (900.0, 300.0, 40.0)
        self._points = CAMERA.backproject(rng.uniform(low, high, (n, 3)))
        self._ids, self._frame, self._rng = np.arange(n), 0, rng
        self._slam: StereoFilter = make_filter(filter_name, camera=CAMERA, noise=NOISE, gate=None, **options)
        self._slam.reset(Start(linear_velocity=np.array([0.0, 0.0, SPEED])))
        for group in range(1, GROUPS + 1):
            self._slam.update(self._observe(n * group // GROUPS))
            self._slam.predict(DT)
            self._frame += 1

    def milliseconds(self) -> float:
        """Mean processor time of predict + update over a burst."""
        elapsed = 0.0
        for _ in range(BURST):
            self._frame += 1
            observation = self._observe(len(self._ids))
            began = time.process_time()
            self._slam.predict(DT)
            self._slam.update(observation)
            elapsed += time.process_time() - began
        return 1000.0 * elapsed / BURST

    def _observe(self, count: int) -> StereoObservation:
        uvd = CAMERA.project(self._points[:count] - (0.0, 0.0, SPEED * DT * self._frame))
        return StereoObservation(self._ids[:count], uvd + self._rng.multivariate_normal(np.zeros(3), NOISE.R, count))


def experiments(sizes: Sequence[int], repeats: int) -> dict[str, partial[Arrays]]:
    """One for each size of the map; each needs the machine for itself."""
    return {f"speed-{n:04d}": partial(timed, n, repeats) for n in sizes}


def timed(n: int, repeats: int) -> Arrays:
    """Milliseconds a frame of each form and filter in each round, (repeats,), at n landmarks."""
    drives = {
        f"{form}.{name}": SlowDrive(n, name, options) for form, options in FORMS.items() for name in (JOINT, DUAL)
    }
    for drive in drives.values():
        drive.milliseconds()  # what is done once is no part of a frame
    times: dict[str, list[float]] = {name: [] for name in drives}
    for _ in range(repeats):
        for name, drive in drives.items():
            times[name].append(drive.milliseconds())
    return {name: np.array(values) for name, values in times.items()}


def milliseconds(results: Mapping[str, Arrays]) -> dict[int, dict[str, FloatArray]]:
    """Size of the map -> "form.filter" -> milliseconds of each round."""
    found = {int(name.removeprefix("speed-")): arrays for name, arrays in results.items() if name.startswith("speed-")}
    return dict(sorted(found.items()))


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of speed."""
    faster = [
        ({"state": form, "landmarks": str(n)}, ratio_interval(times[f"{form}.{JOINT}"], times[f"{form}.{DUAL}"]))
        for form in FORMS
        for n, times in milliseconds(results).items()
    ]
    observation = StereoObservation(np.arange(1), np.array([[600.0, 200.0, 10.0]]))
    counted = []
    for name, model, wanted in (("ours", RangeBearing(), 1), ("competitor", LeftThenRight(), 2)):
        count = len(model.stages(observation, NOISE.R[None]))
        counted.append(ClaimFinding({"filter": name}, Interval(count, count, count), Range(wanted, wanted)))
    return (claim("faster", faster), Claim(SENTENCES["one-update"], tuple(counted)))
