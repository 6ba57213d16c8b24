"""Jacobians against finite differences: the situations, the table of cases and the check, for the tests of all of them.

A case is a function of a perturbation (in the coordinates of the error state) and the Jacobian claimed at zero. Every
case is run in every situation: ordinary ones, and those near the singularities of the parametrisations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.outputs import VELOCITY, Variable
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import ANGULAR, LINEAR, POSITION, ROTATION, CameraState

from .drives import ODD_CAMERA as CAMERA
from .numeric import numeric_jacobian, relative_difference
from .slots import LANDMARKS, MEASUREMENTS
from .third_party import ShearedPair

COUNT = 4
TOLERANCE = 1e-7
OTHER_STEPS = (1e-5, 3e-4)
ROUNDING = 1e-12
"""Of a numerical Jacobian that a part has by default, as `filters.geometry.derivatives` says."""


@dataclass(frozen=True)
class Situation:
    """A pose with its motion, and measurements of landmarks: what the Jacobians are evaluated at."""

    camera: CameraState
    dt: float
    uvd: np.ndarray
    anchor_offset: np.ndarray
    delta: np.ndarray
    step: float = 1e-5

    @property
    def points_c(self) -> np.ndarray:
        """In the camera frame, m."""
        return CAMERA.backproject(self.uvd)

    @property
    def rays_c(self) -> np.ndarray:
        """The same as homogeneous points (M, 4), regular at infinity."""
        return np.column_stack([CAMERA.ray(self.uvd), self.uvd[:, 2] / CAMERA.disparity_constant])

    @property
    def rays_w(self) -> np.ndarray:
        """With directions in W."""
        return np.hstack([self.rays_c[:, :3] @ self.camera.R_wc.T, self.rays_c[:, 3:]])


def _unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def ordinary(rng: np.random.Generator) -> Situation:
    camera = CameraState(
        rng.uniform(-20, 20, 3),
        Rotation.from_quat(rng.standard_normal(4)).as_quat(),
        rng.uniform(-6, 6, 3),
        rng.uniform(-0.8, 0.8, 3),
    )
    uvd = rng.uniform([100.0, 50.0, 2.0], [1200.0, 380.0, 40.0], (COUNT, 3))
    return Situation(camera, 0.1, uvd, rng.uniform(-2, 2, (COUNT, 3)), 0.5 * rng.uniform(0.1, 1) * _unit(rng))


def steep(rng: np.random.Generator) -> Situation:
    """Rays within 1e-3 of the vertical of W, phi near +-90 degrees: the azimuth is nearly undefined."""
    upright = Rotation.from_rotvec([rng.choice([-1, 1]) * np.pi / 2, 0.0, 0.0])
    orientation = Rotation.from_rotvec([0.0, rng.uniform(-3, 3), 0.0]) * upright
    offset = rng.uniform(1e-4, 7e-4, (COUNT, 2)) * rng.choice([-1, 1], (COUNT, 2))
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, :2] = [CAMERA.cx, CAMERA.cy] + offset * [CAMERA.fx, CAMERA.fy]
    return replace(base, camera=replace(base.camera, orientation=orientation.as_quat()), uvd=uvd, step=1e-6)


def at_infinity(rng: np.random.Generator) -> Situation:
    """No disparity, or next to none."""
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] = [0.0, 1e-9, -1e-9, 1e-4]
    return replace(base, uvd=uvd)


def beyond_infinity(rng: np.random.Generator) -> Situation:
    """Disparities below zero."""
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] *= -0.2
    return replace(base, uvd=uvd)


def steep_at_infinity(rng: np.random.Generator) -> Situation:
    """Both at once: vertical rays of landmarks at, before and beyond infinity."""
    base = steep(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] = [0.0, 1e-9, -1e-4, -5.0]
    return replace(base, uvd=uvd)


def half_turn(rng: np.random.Generator) -> Situation:
    """Orientation, turn of the step and correction all near pi."""
    base = ordinary(rng)
    angles = np.pi - rng.uniform(0.0, 1e-3, 2)
    camera = replace(
        base.camera,
        orientation=Rotation.from_rotvec(angles[0] * _unit(rng)).as_quat(),
        angular_velocity=angles[1] * _unit(rng) / base.dt,
    )
    # The correction itself stays 0.01 short of pi, where the logarithm has its cut.
    return replace(base, camera=camera, delta=(np.pi - 0.01) * _unit(rng))


def tiny_turn(rng: np.random.Generator) -> Situation:
    """Turns and corrections of 1e-9 to 1e-4 rad, across the switch from the series to the closed form."""
    base = ordinary(rng)
    sizes = 10 ** rng.uniform(-9, -4, 2)
    camera = replace(base.camera, angular_velocity=sizes[0] * _unit(rng) / base.dt)
    return replace(base, camera=camera, delta=sizes[1] * _unit(rng))


def no_turn(rng: np.random.Generator) -> Situation:
    base = ordinary(rng)
    camera = replace(base.camera, angular_velocity=np.zeros(3), linear_velocity=np.zeros(3))
    return replace(base, camera=camera, delta=np.zeros(3))


SITUATIONS = (ordinary, steep, at_infinity, beyond_infinity, steep_at_infinity, half_turn, tiny_turn, no_turn)
FINITE_POINTS = (ordinary, steep, half_turn, tiny_turn, no_turn)


@dataclass(frozen=True)
class Case:
    """A function on a manifold with the Jacobian claimed for it; `prepare` gives both."""

    name: str
    prepare: Callable[[Situation], tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]]
    situations: tuple[Callable[[np.random.Generator], Situation], ...] = SITUATIONS
    seeds: int = 3


class Cases(list[Case]):
    """A table of cases, filled by a decorator."""

    def case(self, name: str, situations: tuple = SITUATIONS, seeds: int = 3) -> Callable:
        """Add a function that prepares a case."""

        def register(prepare: Callable) -> Callable:
            self.append(Case(name, prepare, situations, seeds))
            return prepare

        return register


def assert_jacobian(named: Case) -> None:
    """The Jacobian claimed is that of finite differences, in all situations."""
    for situation in named.situations:
        for seed in range(named.seeds):
            s = situation(np.random.default_rng(seed))
            function, claimed = named.prepare(s)
            # Too small a step is rounding, too large a one truncation; a wrong Jacobian disagrees with all of them.
            differences = []
            for step in (s.step, *OTHER_STEPS):
                measured = numeric_jacobian(function, claimed.shape[-1], step)
                assert measured.shape == claimed.shape
                beyond_rounding = np.where(np.abs(claimed - measured) < ROUNDING, measured, claimed)
                differences.append(relative_difference(beyond_rounding, measured))
                if differences[-1] < TOLERANCE:
                    break
            assert min(differences) < TOLERANCE, f"{situation.__name__}, seed {seed}: {min(differences):.2g}"


def moved(camera: CameraState, error: np.ndarray, variables: tuple[Variable, ...] = ()) -> CameraState:
    """The camera state with the error numbers of pose, velocity and these variables applied."""
    values, row = dict(camera.variables), 12
    for variable in variables:
        values[variable.name] = variable.retraction.retract(values[variable.name], error[row : row + variable.size])
        row += variable.size
    orientation = Rotation.from_quat(camera.orientation) * Rotation.from_rotvec(error[ROTATION])
    return CameraState(
        camera.position + error[POSITION],
        orientation.as_quat(),
        camera.linear_velocity + error[LINEAR],
        camera.angular_velocity + error[ANGULAR],
        values,
    )


def difference(reference: CameraState, other: CameraState, variables: tuple[Variable, ...] = ()) -> np.ndarray:
    """The error numbers between two camera states."""
    rotation = Rotation.from_quat(reference.orientation).inv() * Rotation.from_quat(other.orientation)
    return np.concatenate(
        [
            other.position - reference.position,
            rotation.as_rotvec(),
            other.linear_velocity - reference.linear_velocity,
            other.angular_velocity - reference.angular_velocity,
            *(x.retraction.local(reference.variables[x.name], other.variables[x.name]) for x in variables),
        ]
    )


def values_of(variables: tuple[Variable, ...]) -> dict[str, np.ndarray]:
    """Values of variables at the start."""
    return {variable.name: variable.value for variable in variables}


MODELS: dict[str, LandmarkModel] = dict(LANDMARKS)


def situations_of(model: LandmarkModel, among: tuple = SITUATIONS) -> tuple:
    """Those in which such landmarks can start."""
    rng = np.random.default_rng
    return tuple(
        situation
        for situation in among
        if all(model.can_start_from(tuple(h)) for s in map(situation, map(rng, range(3))) for h in s.rays_w)
    )


SENSORS: dict[str, MeasurementModel] = {**MEASUREMENTS, "with variables": ShearedPair()}


def values_in(sensor: MeasurementModel, s: Situation) -> dict[str, np.ndarray]:
    """Values of a sensor's variables at the start, and the velocity as the camera feels it."""
    felt = np.concatenate([s.camera.R_wc.T @ s.camera.linear_velocity, s.camera.angular_velocity])
    return {**values_of(sensor.variables), VELOCITY: felt}


def measures(sensor: MeasurementModel, s: Situation) -> bool:
    """Whether the sensor has numbers of the situation that a landmark can start from."""
    values = values_in(sensor, s)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = sensor.predict(CAMERA, s.rays_c, values)
        finite = np.isfinite(z).all() and np.isfinite(sensor.backproject(CAMERA, z[:, :3], values)).all()
    return bool(finite and sensor.in_front(s.rays_c).all())


def visible(sensor: MeasurementModel, among: tuple = SITUATIONS) -> tuple:
    """Situations that the sensor measures."""
    return tuple(x for x in among if all(measures(sensor, x(np.random.default_rng(seed))) for seed in range(3)))
