"""The keyword arguments of the environments, in one place, checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from filters.camera import StereoCamera
from filters.known_names import require_known
from filters.validation import positive
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.rendering.backends import RENDERERS, RendererName
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS, NoiseName
from stereo_slam_env.sensing.rigs import Rig, camera_of
from stereo_slam_env.sensing.sensors import TrackingPolicy
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.surroundings import named_surroundings
from stereo_slam_env.world.vehicle import Head

if TYPE_CHECKING:
    from typing import Self

SENSORS = ("landmarks", "images")
POLICIES = ("route", "agent")
_UNFILTERED_FLOOR = 0.25
"""`tiny` takes the nearest texel, which displaces textures by up to half of one and leaves them sharp, px: the
correlation does not see it. Measured with `stereo-slam scenes noise`."""


@dataclass(frozen=True)
class StereoOptions:
    """Arguments that every environment takes, described there; `as_dict` is JSON-able.

    Raises
    ------
    ValueError
        A value is not allowed; the message says what is.
    """

    route: str = "town"
    surroundings: str = "street"
    moving_cars: int = 0
    pedestrians: int = 0
    randomise: bool = False
    visibility: float = TrackingPolicy.farthest
    blank_from: float | None = None
    rig: Rig = "reference"
    sensor: str = "landmarks"
    renderer: RendererName = "tiny"
    render_images: bool = False
    noise: NoiseName = "pixels"
    sigma: float = 1.0
    max_landmarks: int = 90
    refill_below: int | None = None
    revisit: bool = False
    odometry_sigma_linear: float = 0.1
    odometry_sigma_angular: float = 0.01
    perturbation: float = 1.0
    supersample: int = 1
    tracking_weight: float = 0.02

    def __post_init__(self) -> None:
        named_route(self.route)
        named_surroundings(self.surroundings)
        _one_of("renderer", self.renderer, RENDERERS)
        _one_of("randomise", self.randomise, (True, False))
        _whole("moving_cars", self.moving_cars, 0, 100)
        _whole("pedestrians", self.pedestrians, 0, 100)
        if isinstance(self.rig, str):
            camera_of(self.rig)
        else:  # numbers that are not given are those of the usual rig
            object.__setattr__(self, "rig", camera_of(self.rig, str(type(self).rig)))
        _one_of("sensor", self.sensor, SENSORS)
        _one_of("noise", self.noise, NOISE_MODELS)
        _one_of("render_images", self.render_images, (True, False))
        _one_of("revisit", self.revisit, (True, False))
        positive("sigma", self.sigma)
        _number("visibility", self.visibility, 2 * TrackingPolicy.nearest, TrackingPolicy.farthest)
        if self.blank_from is not None:
            positive("blank_from", self.blank_from, allow_zero=True)
        _whole("max_landmarks", self.max_landmarks, 1, 10_000)
        if self.refill_below is not None:
            _whole("refill_below", self.refill_below, 0, self.max_landmarks)
        _whole("supersample", self.supersample, 1, 4)
        for field in fields(self):
            if field.name.startswith(("odometry_", "perturbation")) or field.name.endswith("_weight"):
                positive(field.name, getattr(self, field.name), allow_zero=True)

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> Self:
        """From keyword arguments; an unknown name is refused with the nearest known one."""
        require_known("there is no argument", given, [field.name for field in fields(cls)])
        return cls(**given)

    @property
    def camera(self) -> StereoCamera:
        """What `rig` stands for."""
        return camera_of(self.rig)

    @property
    def tracking(self) -> TrackingPolicy:
        """How the sensor "landmarks" tracks."""
        refill = self.refill_below
        if refill is None:
            refill = round(self.max_landmarks * TrackingPolicy.refill_below / TrackingPolicy.max_landmarks)
        return TrackingPolicy(
            max_landmarks=self.max_landmarks, refill_below=refill, farthest=self.visibility, revisit=self.revisit
        )

    @property
    def front_end(self) -> TrackerSettings:
        """How the sensor "images" tracks."""
        refill = self.refill_below
        if refill is None:
            refill = round(self.max_landmarks * TrackerSettings.refill_below / TrackerSettings.max_landmarks)
        floor = _UNFILTERED_FLOOR if self.renderer == "tiny" else TrackerSettings.sigma_floor
        return TrackerSettings(max_landmarks=self.max_landmarks, refill_below=refill, sigma_floor=floor)

    @property
    def draws(self) -> bool:
        """Whether frames are rendered even without `render()`."""
        return self.render_images or self.sensor == "images"

    def as_dict(self) -> dict[str, Any]:
        """The keyword arguments that make the same environment."""
        return asdict(self)


@dataclass(frozen=True)
class DriveOptions(StereoOptions):
    """Arguments of `StereoDriveEnv`."""

    policy: str = "agent"
    progress_weight: float = 0.1
    collision_weight: float = 10.0
    goal_weight: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _one_of("policy", self.policy, POLICIES)


@dataclass(frozen=True)
class HeadOptions(StereoOptions):
    """Arguments of an environment whose head moves, for a world in which that matters."""

    route: str = "straight"
    surroundings: str = "groves"
    visibility: float = 30.0
    rig: Rig = "vga"
    max_landmarks: int = 24
    revisit: bool = True
    max_pan: float = 2.0
    max_tilt: float = 0.4
    pan_rate: float = 1.5
    tilt_rate: float = 1.0
    effort_weight: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        _number("max_pan", self.max_pan, 0.0, np.pi)
        _number("max_tilt", self.max_tilt, 0.0, 0.5 * np.pi)
        positive("pan_rate", self.pan_rate)
        positive("tilt_rate", self.tilt_rate)

    def head(self, baseline: float) -> Head:
        """The head that carries eyes `baseline` m apart."""
        return Head(baseline, (self.max_pan, self.max_tilt), (self.pan_rate, self.tilt_rate))


@dataclass(frozen=True)
class GazeOptions(HeadOptions):
    """Arguments of `StereoGazeEnv`."""


@dataclass(frozen=True)
class DriveGazeOptions(HeadOptions, DriveOptions):
    """Arguments of `StereoDriveGazeEnv`."""


def _one_of(name: str, value: object, allowed: Collection[object]) -> None:
    if not any(value == choice and type(value) is type(choice) for choice in allowed):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


def _whole(name: str, value: object, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number from {low} to {high}, got {value!r}")


def _number(name: str, value: Any, low: float, high: float) -> None:
    if positive(name, value, allow_zero=True) > high or float(value) < low:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
