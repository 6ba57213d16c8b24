"""Simulated inertial unit: what it measures along a smooth path, with the errors of a data sheet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from filters import InertialSamples, InertialUnit
from filters.contract.validation import finite_array, positive, require_known
from filters.geometry.arrays import FloatArray

Path = Callable[[FloatArray], tuple[FloatArray, Rotation]]
"""Positions (N, 3), m, and orientations of the left camera at times (N,), s; twice differentiable."""
GRAVITY = 9.81
"""Acceleration of a body that falls, m/s^2."""
_STEP = 1e-4
"""s, of the differences that give velocities."""


@dataclass(frozen=True)
class DataSheet:
    """Errors of an inertial unit, each axis of each sensor for itself."""

    gyro_density: float
    """White noise of the angular rates, rad/s per root of a hertz."""
    accelerometer_density: float
    """White noise of the specific forces, m/s^2 per root of a hertz."""
    gyro_walk: float
    """Random walk of the gyros' biases, rad/s per root of a second."""
    accelerometer_walk: float
    """Random walk of the accelerometers' biases, m/s^2 per root of a second."""
    gyro_bias: float = 0.01
    """Standard deviation of the biases when it is switched on, rad/s."""
    accelerometer_bias: float = 0.1
    """The same of the accelerometers, m/s^2."""
    scale: float = 0.0
    """Standard deviation of the scale, relative, constant over a drive."""
    misalignment: float = 0.0
    """Standard deviation of the stated orientation, rad, each axis, constant over a drive."""

    @property
    def calibrated(self) -> DataSheet:
        """The sheet of a unit whose scales and orientation are exactly as stated: white noise and biases alone."""
        return replace(self, scale=0.0, misalignment=0.0)


DATA_SHEETS: Mapping[str, DataSheet] = MappingProxyType(
    {
        "adis16448": DataSheet(1.7e-4, 2.0e-3, 1.9e-5, 3.0e-3, scale=5e-4, misalignment=5e-4),
        "bmi088": DataSheet(2.4e-4, 1.8e-3, 4.0e-5, 5.0e-3, scale=2e-3, misalignment=2e-3),
        "car": DataSheet(8.7e-4, 5.0e-3, 1.0e-4, 1.0e-2, scale=1e-2, misalignment=5e-3),
    }
)
"""Units by name. ADIS16448: densities and walks as the EuRoC data state them. BMI088: densities of its sheet, 0.014
deg/s and 175 ug per root of a hertz. Car: a cluster for stability control, 0.05 deg/s and 0.5 mg per root of a hertz.
Sheets give no walks in this form, and what is left of scale and alignment depends on the calibration: assumed."""


@dataclass(frozen=True, eq=False)
class Imu:
    """An inertial unit on the rig.

    Parameters
    ----------
    sheet : DataSheet or str
        Its errors, or the name of one of `DATA_SHEETS`.
    position : (3,) array_like
        Of the accelerometers in the camera frame, m.
    orientation : (4,) array_like
        Unit quaternion xyzw that takes its vectors to the camera frame, as stated.
    rate : float
        Samples a second.
    time_offset : float
        Its clock less that of the camera, s, which nobody knows of.

    Raises
    ------
    ValueError
        No such sheet, wrong shapes, a rate that is not above 0.
    """

    sheet: DataSheet | str = "adis16448"
    position: tuple[float, float, float] = (0.05, -0.1, 0.2)
    orientation: tuple[float, float, float, float] = (0.5, -0.5, 0.5, 0.5)
    rate: float = 200.0
    time_offset: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.sheet, str):
            require_known("imu has no data sheet", [self.sheet], DATA_SHEETS)
            object.__setattr__(self, "sheet", DATA_SHEETS[self.sheet])
        positive("imu.rate", self.rate)
        finite_array("imu.time_offset", self.time_offset, ())

    @property
    def unit(self) -> InertialUnit:
        """Data sheet as filters are given it."""
        sheet = self._sheet
        walks = sheet.gyro_walk, sheet.accelerometer_walk
        position, orientation = np.array(self.position), np.array(self.orientation)
        return InertialUnit(position, orientation, sheet.gyro_density, sheet.accelerometer_density, *walks)

    @property
    def name(self) -> str:
        """Name of its data sheet; "own" where that has none."""
        return next((name for name, sheet in DATA_SHEETS.items() if sheet == self.sheet), "own")

    @property
    def _sheet(self) -> DataSheet:
        assert isinstance(self.sheet, DataSheet)
        return self.sheet

    def measure(
        self, path: Path, frames: FloatArray, gravity: FloatArray, rng: np.random.Generator
    ) -> tuple[list[InertialSamples | None], FloatArray]:
        """Samples of the step to each frame, None for the first, and the true biases at the frames.

        Parameters
        ----------
        path : callable
            The left camera over time.
        frames : (K,) ndarray
            Times of the frames, s.
        gravity : (3,) ndarray
            In the frame of the path, m/s^2.
        rng : numpy.random.Generator
            Of all errors.

        Returns
        -------
        list of InertialSamples or None
            K of them.
        (K, 6) ndarray
            Biases of gyros, rad/s, and accelerometers, m/s^2.
        """
        steps = list(self.measured(path, frames, gravity, rng))
        return [samples for samples, _ in steps], np.array([bias for _, bias in steps])

    def measured(
        self, path: Path, frames: FloatArray, gravity: FloatArray, rng: np.random.Generator
    ) -> Iterator[tuple[InertialSamples | None, FloatArray]]:
        """Samples and biases of `measure`, frame by frame."""
        errors, unit = self.errors(rng), self.unit
        yield None, errors.bias
        for begin, end in pairwise(frames.tolist()):
            count = max(1, round((end - begin) * self.rate))
            edges = np.linspace(begin, end, count + 1)
            numbers = errors.added(self.means(path, edges + self.time_offset, gravity), end - begin)
            yield InertialSamples(edges[1:] - begin, numbers[:, :3], numbers[:, 3:], unit), errors.bias

    def errors(self, rng: np.random.Generator) -> UnitErrors:
        """The errors of one drive, drawn."""
        sheet = self._sheet
        bias = np.repeat([sheet.gyro_bias, sheet.accelerometer_bias], 3) * rng.standard_normal(6)
        scales = 1.0 + sheet.scale * rng.standard_normal(6)
        turn = Rotation.from_rotvec(sheet.misalignment * rng.standard_normal(3)).as_matrix()
        return UnitErrors(sheet, bias, scales, turn, rng)

    def means(self, path: Path, edges: FloatArray, gravity: FloatArray) -> FloatArray:
        """Exact means of rates and specific forces between `edges` (N + 1,), s, in its frame; (N, 6)."""
        stated, h = Rotation.from_quat(self.orientation), np.diff(edges)[:, None]
        R, middle = path(edges)[1], path(0.5 * (edges[1:] + edges[:-1]))[1] * stated
        rates = stated.inv().apply((R[:-1].inv() * R[1:]).as_rotvec() / h)
        later, earlier = (at + turned.apply(self.position) for at, turned in (path(edges + e) for e in (_STEP, -_STEP)))
        forces = np.diff((later - earlier) / (2.0 * _STEP), axis=0) / h - gravity
        return np.hstack([rates, middle.inv().apply(forces)])


class UnitErrors:
    """Errors of an inertial unit on one drive: constant ones, biases that walk, and white noise."""

    def __init__(
        self, sheet: DataSheet, bias: FloatArray, scales: FloatArray, turn: FloatArray, rng: np.random.Generator
    ) -> None:
        self.bias, self._scales, self._turn, self._rng = bias, scales, turn, rng
        self._densities = np.repeat([sheet.gyro_density, sheet.accelerometer_density], 3)
        self._walks = np.repeat([sheet.gyro_walk, sheet.accelerometer_walk], 3)

    def added(self, means: FloatArray, dt: float) -> FloatArray:
        """Measurements of exact means (n, 6) over a step of `dt` seconds; afterwards the biases walk."""
        numbers = (means.reshape(-1, 2, 3) @ self._turn.T).reshape(-1, 6)
        numbers = self._scales * numbers + self.bias
        numbers += self._densities / np.sqrt(dt / len(means)) * self._rng.standard_normal(numbers.shape)
        self.bias = self.bias + self._walks * np.sqrt(dt) * self._rng.standard_normal(6)
        return np.asarray(numbers)
