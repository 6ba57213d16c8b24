"""Front ends by name, ours and those of third parties, and `check_front_end`, the checks that every one must pass.

A third party adds a front end with an entry point in the group `stereo_slam.front_ends`::

    [project.entry-points."stereo_slam.front_ends"]
    my-front-end = "my_package:MyFrontEnd"

The object is called as `MyFrontEnd(camera, settings)` and returns a `FrontEnd`. `check_front_end` checks it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from inspect import getdoc
from itertools import pairwise
from typing import Protocol

import numpy as np

from filters import Forecast, StereoCamera
from filters.catalogue.registry import load_factory
from filters.checks.conformance import ConformanceError, ConformanceReport
from filters.contract.validation import did_you_mean, first_line, plain, type_name
from filters.geometry.arrays import FloatArray
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import GreyImage

ENTRY_POINT_GROUP = "stereo_slam.front_ends"
NOT_AVAILABLE = "not available"
"""Begins the line of a front end that is there and cannot be used."""
_OURS = {
    "active-search": "stereo_slam_env.frontend.tracker:StereoTracker",
    "klt": "stereo_slam_env.frontend.other_front_ends:KLTFrontEnd",
    "sift": "stereo_slam_env.frontend.other_front_ends:sift",
    "aliked": "stereo_slam_env.frontend.other_front_ends:aliked",
    "disk": "stereo_slam_env.frontend.other_front_ends:disk",
}


class FrontEnd(Protocol):
    """Turns stereo pairs into (u, v, d) with ids and covariances, pair by pair."""

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Follow the landmarks to the next pair and find new ones.

        Parameters
        ----------
        left, right : (H, W) uint8
            The pair, rectified, grey.
        dt : float, optional
            Time since the previous pair, s; needed from the second pair on.
        forecast : Forecast, optional
            Where a filter expects its landmarks; may be left unused.

        Raises
        ------
        ValueError
            An image has the wrong size or type, or `dt` is missing or not positive.
        """

    def reset(self) -> None:
        """Forget everything; ids begin at 0 again."""


FrontEndFactory = Callable[[StereoCamera, TrackerSettings], FrontEnd]


def make_front_end(camera: StereoCamera, settings: TrackerSettings | None = None) -> FrontEnd:
    """The front end that `settings.method` names, for a rectified rig.

    Raises
    ------
    ValueError
        Unknown name, a front end of a third party that cannot be loaded, or settings that it refuses.
    """
    settings = TrackerSettings() if settings is None else settings
    front_end = front_end_factory(settings.method)(camera, settings)
    if not callable(getattr(front_end, "track", None)) or not callable(getattr(front_end, "reset", None)):
        raise ValueError(f"front end {settings.method!r} made a {type(front_end).__name__} without track and reset")
    return front_end


def front_end_factory(name: str) -> FrontEndFactory:
    """Factory of the front end of that name; raises as `make_front_end`."""
    points = _points()
    if name not in points:
        names = ", ".join(points)
        raise ValueError(f"front end must be one of {names}, got {name!r}{did_you_mean(name, points)}")
    factory: FrontEndFactory = load_factory("front end", points[name])
    return factory


def available_front_ends() -> dict[str, str]:
    """Names and one line on each; one of a third party that cannot be loaded says so instead."""
    lines = {}
    for name, point in _points().items():
        try:
            lines[name] = plain((getdoc(load_factory("front end", point)) or "no description").splitlines()[0])
        except ValueError as error:
            lines[name] = f"{NOT_AVAILABLE}: {error}"
    return lines


def _points() -> dict[str, EntryPoint]:
    ours = {name: EntryPoint(name, value, ENTRY_POINT_GROUP) for name, value in _OURS.items()}
    return {**{point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}, **ours}


CAMERA = StereoCamera(300.0, 300.0, 239.5, 119.5, 0.6, 480, 240)
DISPARITY = 12.4
"""Of the textured wall that the camera drives past, px."""
SHIFT = np.array([1.37, -0.61])
"""By which its picture moves from pair to pair, px."""
PAIRS, DT = 8, 0.1
FEWEST = 10
"""Landmarks that must be measured in each pair."""
BIAS = 0.1
"""Median error of a coordinate that fails, px."""
OUTLIER, OUTLIERS = 1.5, 0.1
"""Errors beyond the first, px, may be so large a share."""

Run = list[TrackedPair]


def check_front_end(
    factory: str | FrontEndFactory, settings: TrackerSettings | None = None, *, raise_on_failure: bool = True
) -> ConformanceReport:
    """Check that a front end keeps its contract, on a wall of known texture whose picture moves by parts of a pixel.

    Parameters
    ----------
    factory : str or callable
        One of `available_front_ends()`; or what an entry point would name.
    settings : TrackerSettings, optional
        What it is made with, beside a `max_landmarks` of 60.
    raise_on_failure : bool
        Raise if a check fails; else only report.

    Raises
    ------
    ConformanceError
        Checks failed; the message lists them.
    """
    make = front_end_factory(factory) if isinstance(factory, str) else factory
    usual = TrackerSettings(max_landmarks=60, refill_below=50) if settings is None else settings
    name = factory if isinstance(factory, str) else getattr(factory, "__name__", type(factory).__name__)
    passed, failed = [], []
    for check in _CHECKS:
        line = (check.__doc__ or "").splitlines()[0]
        try:
            fault = check(lambda: make(CAMERA, usual))
        except Exception as error:  # whatever a stranger's code raises is the fault
            fault = f"{type_name(error)}: {first_line(error)}"
        if fault:
            failed.append(f"{line} {fault}")
        else:
            passed.append(line)
    report = ConformanceReport(name, tuple(passed), tuple(failed))
    if failed and raise_on_failure:
        raise ConformanceError(str(report))
    return report


Make = Callable[[], FrontEnd]


def _finds_landmarks(make: Make) -> str:
    """It measures landmarks in every pair, ids ascending and unique, with shapes as `TrackedPair` says."""
    for number, pair in enumerate(_run(make())):
        count = len(pair.ids)
        if count < FEWEST:
            return f"pair {number} has {count} landmarks, {FEWEST} are asked for"
        if np.asarray(pair.ids).dtype != np.int64 or (np.diff(pair.ids) <= 0).any():
            return f"pair {number}: ids must be int64 and ascend"
        if pair.uvd.shape != (count, 3) or pair.R.shape != (count, 3, 3) or not np.isfinite(pair.uvd).all():
            return f"pair {number}: uvd {pair.uvd.shape} and R {pair.R.shape} must be finite, (M, 3) and (M, 3, 3)"
    return ""


def _claims_covariances(make: Make) -> str:
    """Every R is symmetric and positive definite."""
    for number, pair in enumerate(_run(make())):
        if np.abs(pair.R - pair.R.transpose(0, 2, 1)).max() > 1e-9 or np.linalg.eigvalsh(pair.R).min() <= 0:
            return f"pair {number} has one that is not"
    return ""


def _follows_them(make: Make) -> str:
    """Landmarks are followed: half of them are measured in the next pair, too."""
    pairs = _run(make())
    for number, (before, now) in enumerate(pairwise(pairs[2:]), start=3):
        if (share := np.isin(before.ids, now.ids).mean()) < 0.5:
            return f"pair {number} has {share:.0%} of those before"
    return ""


def _measures_parts_of_a_pixel(make: Make) -> str:
    """Measured (u, v) move as the picture does, and d is that of the wall, to parts of a pixel."""
    first: dict[int, FloatArray] = {}
    errors = []
    for number, pair in enumerate(_run(make())):
        for landmark, uvd in zip(pair.ids.tolist(), pair.uvd, strict=True):
            start = first.setdefault(landmark, np.array([*(uvd[:2] - number * SHIFT), DISPARITY]))
            errors.append(uvd - start - [*(number * SHIFT), 0.0])
    error = np.array(errors)
    bias, beyond = np.median(error, axis=0), float((np.abs(error) > OUTLIER).any(axis=1).mean())
    if np.abs(bias).max() > BIAS:
        return f"the median error of (u, v, d) is {np.round(bias, 3).tolist()} px, at most {BIAS} is allowed"
    return f"{beyond:.0%} are wrong by more than {OUTLIER} px" if beyond > OUTLIERS else ""


def _never_reuses_ids(make: Make) -> str:
    """An id that was dropped does not come again."""
    gone_ids: set[int] = set()
    for number, pair in enumerate(_run(make())):
        if back := gone_ids & set(pair.ids.tolist()):
            return f"pair {number} has {min(back)} again"
        gone_ids |= set(np.asarray(pair.dropped).tolist())
    return ""


def _is_deterministic(make: Make) -> str:
    """The same pairs give the same bits, after `reset` and with another one, too."""
    one = make()
    first = _run(one)
    one.reset()
    for what, again in (("after reset", _run(one)), ("with another front end", _run(make()))):
        for a, b in zip(first, again, strict=True):
            if not (np.array_equal(a.ids, b.ids) and np.array_equal(a.uvd, b.uvd) and np.array_equal(a.R, b.R)):
                return f"not {what}"
    return ""


def _takes_forecasts(make: Make) -> str:
    """A forecast is used or left: one without landmarks changes no contract."""
    front_end = make()
    nothing = Forecast(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool))
    for number, (left, right) in enumerate(_pairs()[:3]):
        tracked = front_end.track(left, right, DT if number else None, nothing if number else None)
    return "" if len(tracked.ids) >= FEWEST else f"{len(tracked.ids)} landmarks are left"


def _refuses_what_is_wrong(make: Make) -> str:
    """Images of another size or type and a `dt` that is missing or not positive are a `ValueError`."""
    left, right = _pairs()[0]
    front_end = make()
    front_end.track(left, right)
    for what, arguments in (
        ("a smaller image", (left[:-1], right, DT)),
        ("a float image", (left.astype(np.float32), right, DT)),
        ("no dt", (left, right, None)),
        ("dt = 0", (left, right, 0.0)),
        ("dt = -1", (left, right, -1.0)),
    ):
        try:
            front_end.track(*arguments)
        except ValueError:
            continue
        return f"{what} is taken"
    return ""


def _leaves_images_alone(make: Make) -> str:
    """Images are not written to, and may be overwritten by the camera afterwards."""
    buffer = [image.copy() for image in _pairs()[0]]
    front_end, reference = make(), _run(make())
    for number, pair in enumerate(_pairs()):
        for mine, image in zip(buffer, pair, strict=True):
            mine[:] = image
        tracked = front_end.track(buffer[0], buffer[1], DT if number else None)
        if not all(np.array_equal(mine, image) for mine, image in zip(buffer, pair, strict=True)):
            return "they are written to"
        if not np.array_equal(tracked.uvd, reference[number].uvd):
            return "an image is kept that was overwritten"
    return ""


_CHECKS = (
    _finds_landmarks,
    _claims_covariances,
    _follows_them,
    _measures_parts_of_a_pixel,
    _never_reuses_ids,
    _is_deterministic,
    _takes_forecasts,
    _refuses_what_is_wrong,
    _leaves_images_alone,
)


def _run(front_end: FrontEnd) -> Run:
    return [front_end.track(left, right, DT if k else None) for k, (left, right) in enumerate(_pairs())]


@lru_cache(maxsize=1)
def _pairs() -> tuple[tuple[GreyImage, GreyImage], ...]:
    """Pictures of the wall, whose grey values between the pixels are known: a sum of plane waves."""
    return tuple(_drawn())


def _drawn() -> Iterator[tuple[GreyImage, GreyImage]]:
    rng, count = np.random.default_rng(0), 150
    length = np.exp(rng.uniform(np.log(6.0), np.log(40.0), count))
    angle, phase = rng.uniform(0, 2 * np.pi, (2, count))
    k = 2 * np.pi / length * np.stack([np.cos(angle), np.sin(angle)])
    u, v = np.arange(CAMERA.width), np.arange(CAMERA.height)

    def picture(shift_u: float, shift_v: float) -> GreyImage:
        columns = np.exp(1j * np.multiply.outer(u - shift_u, k[0]))
        rows = np.exp(1j * (np.multiply.outer(v - shift_v, k[1]) + phase))
        grey = 128.0 + 35.0 / np.sqrt(0.5 * count) * (rows @ columns.T).real
        return np.asarray(np.rint(np.clip(grey, 0, 255)), dtype=np.uint8)

    for number in range(PAIRS):
        du, dv = number * SHIFT
        yield picture(du, dv), picture(du - DISPARITY, dv)
