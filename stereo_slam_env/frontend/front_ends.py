"""Registry of front ends: ours by name, and those of third parties.

A third party adds a front end with an entry point in the group `stereo_slam.front_ends`::

    [project.entry-points."stereo_slam.front_ends"]
    my-front-end = "my_package:MyFrontEnd"

The object is called as `MyFrontEnd(camera, settings)` and returns a `FrontEnd`. `check_front_end` checks it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from inspect import getdoc
from typing import Protocol

from filters import Forecast, StereoCamera
from filters.catalogue.registry import load_factory
from filters.contract.validation import did_you_mean, plain
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import GreyImage

ENTRY_POINT_GROUP = "stereo_slam.front_ends"
NOT_AVAILABLE = "not available"
"""Begins the line of a front end that is there and cannot be used."""
_OURS = {
    "active-search": "stereo_slam_env.frontend.tracker:StereoTracker",
    "klt": "stereo_slam_env.frontend.klt:KLTFrontEnd",
    "sift": "stereo_slam_env.frontend.features:sift",
    "aliked": "stereo_slam_env.frontend.features:aliked",
    "disk": "stereo_slam_env.frontend.features:disk",
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
    made = front_end_factory(settings.method)(camera, settings)
    if not callable(getattr(made, "track", None)) or not callable(getattr(made, "reset", None)):
        raise ValueError(f"front end {settings.method!r} made a {type(made).__name__} without track and reset")
    return made


def front_end_factory(name: str) -> FrontEndFactory:
    """Factory of the front end of that name; raises as `make_front_end`."""
    points = _points()
    if name not in points:
        known = ", ".join(points)
        raise ValueError(f"front end must be one of {known}, got {name!r}{did_you_mean(name, points)}")
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
