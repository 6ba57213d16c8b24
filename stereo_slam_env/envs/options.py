"""The keyword arguments of the driving environment, in one place, checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from filters.known_names import require_known
from filters.validation import positive
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.rendering.backends import RENDERERS
from stereo_slam_env.sensing.landmark_sensor import TrackingPolicy
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.route_files import named_route
from stereo_slam_env.world.surroundings import SURROUNDINGS

SENSORS = ("landmarks", "images")
POLICIES = ("route", "agent")
_UNFILTERED_FLOOR = 0.25
"""`tiny` takes the nearest texel, which displaces textures by up to half of one and leaves them sharp, px: the
correlation does not see it. Measured with `stereo-slam scenes noise`."""


@dataclass(frozen=True)
class DriveOptions:
    """Arguments of `StereoDriveEnv`, described there; all are JSON-able.

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
    policy: str = "agent"
    rig: str = "reference"
    sensor: str = "landmarks"
    renderer: str = "tiny"
    render_images: bool = False
    noise: str = "pixels"
    sigma: float = 1.0
    max_landmarks: int = 90
    refill_below: int | None = None
    revisit: bool = False
    odometry_sigma_linear: float = 0.1
    odometry_sigma_angular: float = 0.01
    perturbation: float = 1.0
    supersample: int = 1

    def __post_init__(self) -> None:
        named_route(self.route)
        _one_of("surroundings", self.surroundings, SURROUNDINGS)
        _one_of("renderer", self.renderer, RENDERERS)
        _one_of("randomise", self.randomise, (True, False))
        _whole("moving_cars", self.moving_cars, 0, 100)
        _whole("pedestrians", self.pedestrians, 0, 100)
        _one_of("policy", self.policy, POLICIES)
        _one_of("rig", self.rig, RIGS)
        _one_of("sensor", self.sensor, SENSORS)
        _one_of("noise", self.noise, NOISE_MODELS)
        _one_of("render_images", self.render_images, (True, False))
        _one_of("revisit", self.revisit, (True, False))
        positive("sigma", self.sigma)
        for name in ("odometry_sigma_linear", "odometry_sigma_angular", "perturbation"):
            positive(name, getattr(self, name), allow_zero=True)
        _whole("max_landmarks", self.max_landmarks, 1, 10_000)
        if self.refill_below is not None:
            _whole("refill_below", self.refill_below, 0, self.max_landmarks)
        _whole("supersample", self.supersample, 1, 4)

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> DriveOptions:
        """From keyword arguments; an unknown name is refused with the nearest known one."""
        require_known("there is no argument", given, [field.name for field in fields(cls)])
        return cls(**given)

    @property
    def tracking(self) -> TrackingPolicy:
        """How the sensor "landmarks" tracks."""
        refill = self.refill_below
        if refill is None:
            refill = round(self.max_landmarks * TrackingPolicy.refill_below / TrackingPolicy.max_landmarks)
        return TrackingPolicy(max_landmarks=self.max_landmarks, refill_below=refill, revisit=self.revisit)

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


def _one_of(name: str, value: object, allowed: Collection[object]) -> None:
    if not any(value == choice and type(value) is type(choice) for choice in allowed):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


def _whole(name: str, value: object, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number from {low} to {high}, got {value!r}")
