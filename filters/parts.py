"""The five slots of a filter, and the parts that can be named in them.

A part is given as an object, by its name, or as a table of its settings with its name, {"name": "hybrid",
"linearity_limit": 0.02}: alike in Python, in scenario files and on the command line. A third party adds a part with an
entry point in the group of the slot, such as::

    [project.entry-points."stereo_slam.landmarks"]
    my-landmark = "my_package:MyLandmark"

The object is called with the settings and returns a part.
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from filters.contract.validation import did_you_mean, first_line, require_known
from filters.errors import (
    ErrorDefinition,
    Extended,
    FirstEstimates,
    LeftInvariant,
    Linearisation,
    QuaternionError,
    RightInvariant,
    RotationVectorError,
    Unscented,
)
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import Hybrid, InverseDepth, SharedAnchorInverseDepth
from filters.landmarks.landmark_model import LandmarkModel
from filters.landmarks.spherical import Polar, Spherical
from filters.measurements.measurement_model import MeasurementModel
from filters.measurements.other_cameras import DepthCamera, FisheyePair, UnrectifiedPair
from filters.measurements.rectified_pair import CalibratedPair, LeftOnly, LeftThenRight, RangeBearing, Stacked
from filters.motions.constant_velocity import ConstantVelocity, VelocityDriven
from filters.motions.motion_model import MotionModel
from filters.motions.strapdown import Strapdown

Named = str | Mapping[str, Any]
"""Name of a part, or its settings with its name."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Slot:
    """A slot of a filter."""

    kind: type
    """Base class of its parts."""
    named: Mapping[str, Callable[..., Any]]
    """The parts of this package; the first is what a table of settings without a name means."""
    group: str
    """Entry points of others."""


SLOTS: Mapping[str, Slot] = {
    "landmark": Slot(
        LandmarkModel,
        {
            "inverse-depth": InverseDepth,
            "shared-anchor": SharedAnchorInverseDepth,
            "euclidean": Euclidean,
            "hybrid": Hybrid,
            "spherical": Spherical,
            "polar": Polar,
        },
        "stereo_slam.landmarks",
    ),
    "measurement": Slot(
        MeasurementModel,
        {
            "joint": RangeBearing,
            "sequential": LeftThenRight,
            "stacked": Stacked,
            "left": LeftOnly,
            "calibrated": CalibratedPair,
            "unrectified": UnrectifiedPair,
            "depth": DepthCamera,
            "fisheye": FisheyePair,
        },
        "stereo_slam.measurements",
    ),
    "motion": Slot(
        MotionModel,
        {"constant-velocity": ConstantVelocity, "velocity-driven": VelocityDriven, "strapdown": Strapdown},
        "stereo_slam.motions",
    ),
    "error": Slot(
        ErrorDefinition,
        {
            "quaternion": QuaternionError,
            "so3": RotationVectorError,
            "first-estimates": FirstEstimates,
            "right-invariant": RightInvariant,
            "left-invariant": LeftInvariant,
        },
        "stereo_slam.errors",
    ),
    "update": Slot(Linearisation, {"extended": Extended, "unscented": Unscented}, "stereo_slam.updates"),
}


def make_part(slot: str, value: object) -> Any:
    """The part that `value` stands for.

    Parameters
    ----------
    slot : {"landmark", "measurement", "motion", "error", "update"}
        Which one.
    value : str, mapping or part
        Its name, its settings with its name under "name", or the part itself.

    Raises
    ------
    ValueError
        There is no such part, or it has no such setting.
    """
    kind = SLOTS[slot].kind
    if isinstance(value, kind):
        return value
    name, settings = value, {}
    if isinstance(value, Mapping):
        settings = {key: setting for key, setting in value.items() if key != "name"}
        name = value.get("name", next(iter(SLOTS[slot].named)))
    built_in = SLOTS[slot].named
    # Reading what is installed takes longer than making a filter.
    named = built_in if isinstance(name, str) and name in built_in else _named(slot)
    if not isinstance(name, str) or name not in named:
        hint = did_you_mean(name, named)
        raise ValueError(
            f"{slot} must be one of {', '.join(map(repr, named))}, or a {kind.__name__}, got {name!r}{hint}"
        )
    make = named[name]
    require_known(f"{slot} {name!r} has no setting", settings, _settings(make))
    part = make(**settings)
    if not isinstance(part, kind):
        raise ValueError(f"{slot} {name!r} made a {type(part).__name__}, not a {kind.__name__}: derive it from that")
    return part


def available_parts(slot: str) -> dict[str, str]:
    """Names of the parts of a slot, with one line on each."""
    return {name: (inspect.getdoc(make) or "no description").splitlines()[0] for name, make in _named(slot).items()}


def _settings(make: Callable[..., Any]) -> list[str]:
    """Names of the settings of a part."""
    return list(inspect.signature(make).parameters)


def _named(slot: str) -> dict[str, Callable[..., Any]]:
    """Parts by name; one of a third party that cannot be loaded is left out, with a line in the log."""
    named = dict(SLOTS[slot].named)
    for entry_point in entry_points(group=SLOTS[slot].group):
        if entry_point.name in named:
            _log.warning("%s %r of %s is hidden by the built-in one", slot, entry_point.name, entry_point.value)
            continue
        try:
            named[entry_point.name] = entry_point.load()
        except Exception as error:  # whatever a stranger's module does at import must not take the run down
            _log.warning(
                "%s %r (%s) cannot be loaded: %s", slot, entry_point.name, entry_point.value, first_line(error)
            )
    return named
