"""Keyword arguments of the environments, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from filters.contract.validation import did_you_mean, one_of, positive, require_known, whole_number
from filters.geometry.camera import StereoCamera
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.rendering.renderers import RendererName, image_quality
from stereo_slam_env.sensing.corruptions import NoiseName
from stereo_slam_env.sensing.imu import DATA_SHEETS, DataSheet
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.sensing.rigs import RIGS, Rig, camera_of
from stereo_slam_env.simulator.scene_arrays import landmarks_on
from stereo_slam_env.simulator.simulator import Physics
from stereo_slam_env.simulator.state import ODOMETRY_SIGMAS
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.surroundings import named_surroundings
from stereo_slam_env.world.traffic import Bus
from stereo_slam_env.world.vehicle import Head

if TYPE_CHECKING:
    from typing import Self


Sensor = Literal["landmarks", "images"]
DrivenBy = Literal["agent", "route"]
Vehicle = Literal["kinematic", "smooth"]


class UnknownArgument(TypeError, ValueError):
    """There is no argument of that name: a `TypeError` as with any function, a `ValueError` as with wrong values.

    The words are those of Python: TorchRL looks for them.
    """


@dataclass(frozen=True)
class StereoOptions:
    """Arguments that every environment takes, described there; `as_dict` is JSON-able, a wrong value a `ValueError`."""

    route: str = "town"
    surroundings: str = "street"
    moving_cars: int = 0
    pedestrians: int = 0
    bus: Bus | None = None
    moving_landmarks: int = 0
    randomise: bool = False
    visibility: float = TrackingPolicy.farthest
    blank_from: float | None = None
    rig: Rig = "reference"
    sensor: Sensor = "landmarks"
    renderer: RendererName = "tiny"
    render_images: bool = False
    noise: NoiseName = "pixels"
    sigma: float = 1.0
    lasting: float = 0.0
    lasting_time: float | None = None
    max_landmarks: int = 90
    refill_below: int | None = None
    revisit: bool = False
    odometry_sigma_linear: float = ODOMETRY_SIGMAS[0]
    odometry_sigma_angular: float = ODOMETRY_SIGMAS[1]
    perturbation: float = 1.0
    supersample: int = 1
    front_end_name: str = "active-search"
    physics: Physics = "exact"
    observe_ids: bool = True
    tracking_weight: float = 0.05

    def __post_init__(self) -> None:
        named_route(self.route)
        named_surroundings(self.surroundings)
        for name, kind in get_type_hints(type(self)).items():
            choices = (True, False) if kind is bool else get_args(kind) if get_origin(kind) is Literal else None
            if choices is not None:
                one_of(name, getattr(self, name), choices)
        limits = {"max_landmarks": (1, 10_000), "supersample": (1, 4)}
        limits |= dict.fromkeys(("moving_cars", "pedestrians", "moving_landmarks"), (0, 100))
        for name, (low, high) in limits.items():
            whole_number(name, getattr(self, name), low, high)
        if not (
            isinstance(self.rig, str) and self.rig in RIGS
        ):  # numbers that are not given are those of the usual rig
            object.__setattr__(self, "rig", camera_of(self.rig, str(type(self).rig)))
        if self.front_end_name != type(self).front_end_name:
            from stereo_slam_env.frontend.front_ends import front_end_factory  # OpenCV, only where it is needed

            front_end_factory(self.front_end_name)
        if self.bus is not None:
            one_of("bus", self.bus, get_args(Bus))
        if self.bus == "stops-and-goes" and getattr(self, "policy", "route") == "route":
            raise ValueError("bus must not be 'stops-and-goes' where a script drives, which would run into it")
        if self.moving_landmarks and self.sensor == "images":
            raise ValueError(
                "moving_landmarks must be 0 with sensor='images', whose front end drops what moves: use "
                "sensor='landmarks'"
            )
        positive("sigma", self.sigma)
        positive("lasting", self.lasting, allow_zero=True)
        if self.lasting_time is not None:
            positive("lasting_time", self.lasting_time)
        _number("visibility", self.visibility, 2 * TrackingPolicy.nearest, TrackingPolicy.farthest)
        if self.blank_from is not None:
            positive("blank_from", self.blank_from, allow_zero=True)
        if self.refill_below is not None:
            whole_number("refill_below", self.refill_below, 0, self.max_landmarks)
        for field in fields(self):
            if field.name.startswith(("odometry_", "perturbation")) or field.name.endswith("_weight"):
                positive(field.name, getattr(self, field.name), allow_zero=True)

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> Self:
        """Read keyword arguments; an unknown name is refused with the nearest known one."""
        field_names = [field.name for field in fields(cls)]
        for name in given:
            if name not in field_names:
                near = did_you_mean(name, field_names) or "."
                raise UnknownArgument(f"unexpected keyword argument {name!r}{near} Known: {', '.join(field_names)}")
        return cls(**given)

    @property
    def camera(self) -> StereoCamera:
        """The stereo camera of `rig`."""
        return camera_of(self.rig)

    @property
    def tracking(self) -> TrackingPolicy:
        """Tracking of the sensor "landmarks"."""
        refill = self._refill(TrackingPolicy)
        return TrackingPolicy(
            max_landmarks=self.max_landmarks, refill_below=refill, farthest=self.visibility, revisit=self.revisit
        )

    @property
    def moving_bodies(self) -> int:
        """Most moving bodies in a scene."""
        return int(self.moving_cars) + int(self.pedestrians) + (self.bus is not None)

    @property
    def max_measurements(self) -> int:
        """Most measurements in one frame: of `max_landmarks`, and of `moving_landmarks` on each moving body."""
        on_people = int(self.pedestrians) * landmarks_on("pedestrian", int(self.moving_landmarks))
        on_others = (self.moving_bodies - int(self.pedestrians)) * int(self.moving_landmarks)
        return int(self.max_landmarks) + on_others + on_people

    @property
    def front_end(self) -> TrackerSettings:
        """Tracking of the sensor "images"."""
        quality = image_quality(self.renderer, self.supersample)
        return TrackerSettings(
            method=self.front_end_name,
            max_landmarks=self.max_landmarks,
            refill_below=self._refill(TrackerSettings),
            sigma_floor=max(quality.texture_sigma, TrackerSettings.sigma_floor),
            image_blur=quality.blur,
        )

    def _refill(self, usual: type[TrackingPolicy | TrackerSettings]) -> int:
        """`refill_below`, or the usual share of `max_landmarks`."""
        if self.refill_below is not None:
            return self.refill_below
        return round(self.max_landmarks * usual.refill_below / usual.max_landmarks)

    @property
    def draws(self) -> bool:
        """Whether frames are rendered even without `render()`."""
        return self.render_images or self.sensor == "images"

    def as_dict(self) -> dict[str, Any]:
        """The keyword arguments that make the same environment."""
        return asdict(self)


@dataclass(frozen=True)
class DriveOptions(StereoOptions):
    """Arguments of the environment `StereoDriveEnv`."""

    route: str | None = None  # type: ignore[assignment]
    policy: DrivenBy = "agent"
    lane: float = 2.0
    slowest: float = 6.0
    vehicle: Vehicle = "kinematic"
    roughness: float = 1.0
    imu: str | None = None
    imu_calibrated: bool = False
    progress_weight: float = 0.1
    collision_weight: float = 10.0
    goal_weight: float = 10.0
    time_weight: float = 0.4
    jerk_weight: float = 0.05

    def __post_init__(self) -> None:
        if self.route is None:
            object.__setattr__(self, "route", "random-town" if self.policy == "agent" else "town")
        super().__post_init__()
        positive("lane", self.lane)
        positive("slowest", self.slowest, allow_zero=True)
        positive("roughness", self.roughness, allow_zero=True)
        if self.imu is not None:
            require_known("imu has no data sheet", [self.imu], DATA_SHEETS)
            if self.vehicle != "smooth":
                raise ValueError(
                    "imu must be None with vehicle='kinematic', whose velocity jumps: use vehicle='smooth'"
                )

    @property
    def data_sheet(self) -> DataSheet:
        """Errors of the inertial unit; a `KeyError` where there is none."""
        sheet = DATA_SHEETS[self.imu or ""]
        return sheet.calibrated if self.imu_calibrated else sheet


@dataclass(frozen=True)
class HeadOptions(StereoOptions):
    """Arguments of an environment whose head moves; the defaults are a world where gaze matters."""

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
        """The head, with cameras `baseline` m apart."""
        return Head(baseline, (self.max_pan, self.max_tilt), (self.pan_rate, self.tilt_rate))


@dataclass(frozen=True)
class GazeOptions(HeadOptions):
    """Arguments of the environment `StereoGazeEnv`."""


@dataclass(frozen=True)
class DriveGazeOptions(HeadOptions, DriveOptions):
    """Arguments of the environment `StereoDriveGazeEnv`."""

    route: str | None = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.vehicle == "smooth" or self.imu is not None:
            raise ValueError(
                "vehicle must be 'kinematic' and imu None with a head that turns, whose rates are not continuous: "
                "take StereoSlam/Drive-v0"
            )
        super().__post_init__()


def _number(name: str, value: Any, low: float, high: float) -> None:
    if positive(name, value, allow_zero=True) > high or float(value) < low:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
