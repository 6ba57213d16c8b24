"""`check_filter`: the checks that every filter must pass (after scikit-learn's `check_estimator`).

Most checks use a short drive past a cloud of points and need no reference implementation; accuracy is held against
`inverse-depth` on longer drives. Camera and noise are those that the factory was handed. A filter that asks
for odometry or inertial samples is given some.
"""

from __future__ import annotations

import copy
import inspect
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from filters.catalogue.registry import USUAL, FilterFactory, filter_factory, label_of, make_with_common_options
from filters.checks.consistency import blind_pose_error, chi_square_quantile, fault_of, nees
from filters.checks.synthetic_drives import (
    DT,
    SPEED,
    START,
    START_COVARIANCE,
    StraightDrive,
    WindingDrive,
    predict_step,
)
from filters.contract.inputs import Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import Forecast, PoseBelief, UpdateReport
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import first_line, type_name
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera

REFERENCE_CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
REFERENCE_NOISE = StereoNoise.independent_pixels(1.0)

WORST_FACTOR = 6.0
"""Errors so many times those of `inverse-depth` fail. `monocular` has 3 times, ten times the pixel noise gives 11."""

GREATEST_NEES = 1.8
"""A consistent filter exceeds it over 20 x 6 degrees of freedom with a probability of 2e-7."""
LEAST_NEES, LEAST_NEES_OF_FORECASTS = 0.2, 0.4
"""A filter may be cautious: `coloured-noise-causal`, which reckons with errors that last, has 0.34 and 0.74."""
OTHER_RIG = StereoCamera(450.0, 470.0, 330.0, 200.0, 0.3, 640, 480), StereoNoise.independent_pixels(0.25)
"""Unlike the reference in every number; a standard deviation taken for a variance shows, which it does not at 1 px."""
OTHER_ORIENTATION = rotations.exp_quaternion(np.array([0.4, 1.9, -0.6]))
OTHER_HEADING = rotations.matrix(OTHER_ORIENTATION)[:, 2]

LONGEST_DELAY = 20
"""Frames after which a filter with delayed updates must have reported what it was given."""

TOLERANCE = 1e-9
"""Of its largest entry: numbers that differ by less are the same, but for rounding.

A filter that keeps an information matrix has a covariance only after a solution, with some 1e-12 of rounding.
"""

_EMPTY = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def require(condition: object, message: str) -> None:
    """Raise an `AssertionError` unless the condition holds, under `python -O`, too."""
    if not condition:
        raise AssertionError(message)


@dataclass(frozen=True)
class Make:
    """Makes the filter that is checked, anew at each call."""

    factory: FilterFactory
    """Called with `camera` and `noise`; or without arguments, where there is no rig."""
    rig: tuple[StereoCamera, StereoNoise] | None
    """Camera and noise that the filter is handed, and is driven with; None: it brings its own."""

    def __call__(self) -> StereoFilter:
        """New filter of the factory."""
        return self.factory() if self.rig is None else self.factory(*self.rig)

    def drive(self, seed: int = 0, start: Start = START, steps: Sequence[float] = (DT,)) -> StraightDrive:
        """A straight drive of its rig."""
        return StraightDrive.simulated(*self.driven_rig, seed, start, steps)

    @cached_property
    def driven_rig(self) -> tuple[StereoCamera, StereoNoise]:
        """Camera and noise of the drives."""
        if self.rig is not None:
            return self.rig
        stereo_filter = self.factory()
        return stereo_filter.camera, stereo_filter.noise


class ConformanceError(AssertionError):
    """Some checks failed; the message lists each of them."""


@dataclass(frozen=True)
class ConformanceReport:
    """Result of `check_filter` or `check_part`."""

    filter_name: str
    """Class of the filter or of the part."""
    passed: tuple[str, ...]
    """One line for each check."""
    failed: tuple[str, ...]
    """One line for each check, with what is wrong."""
    runs: str = ""
    """How a part runs in a filter, where that is known."""

    def __str__(self) -> str:
        count = f"{self.filter_name}: {len(self.passed)} checks passed, {len(self.failed)} failed"
        lines = [f"{count}; runs {self.runs}" if self.runs else count]
        return "\n".join([*lines, *(f"  failed: {line}" for line in self.failed)])


def check_filter(factory: str | FilterFactory, *, raise_on_failure: bool = True) -> ConformanceReport:
    """Check that filters made by `factory` keep the contract of `StereoFilter`.

    Parameters
    ----------
    factory : str or callable
        A name of `available_filters()`, or a filter class or a function, which is called as a benchmark does: with
        `camera`, `noise` and the `filters.catalogue.registry` that it leaves open; or without arguments if it
        takes none.
    raise_on_failure : bool
        Raise if a check fails; else only report.

    Returns
    -------
    ConformanceReport

    Raises
    ------
    ConformanceError
        With every failed check listed.
    ValueError
        There is no filter of that name.
    """
    make = as_benchmarks_make_it(factory)
    # What cannot be made fails this one check, not all of them.
    alone = checked(label_of(factory), CHECKS[:1], make, False)
    return checked(label_of(factory), CHECKS[:1] if alone.failed else CHECKS, make, raise_on_failure)


def checked(
    name: str, checks: Sequence[Callable[[Any], None]], subject: object, raise_on_failure: bool, runs: str = ""
) -> ConformanceReport:
    """Run the checks of a filter or a part; see `check_filter`."""
    passed, failed = [], []
    for check in checks:
        line = (inspect.getdoc(check) or check.__name__).splitlines()[0].rstrip(".")
        try:
            check(subject)
        except AssertionError as error:
            failed.append(f"{line}: {error}")
        except Exception as error:  # whatever else it raises is a failed check, too
            failed.append(f"{line}: raised {type_name(error)}: {first_line(error)}")
        else:
            passed.append(line)
    report = ConformanceReport(name, tuple(passed), tuple(failed), runs)
    if failed and raise_on_failure:
        raise ConformanceError(str(report))
    return report


def as_benchmarks_make_it(factory: str | FilterFactory) -> Make:
    """Factory that makes the filter as a benchmark does; takes the argument of `check_filter`."""
    factory = filter_factory(factory)
    if _takes(factory) and not _takes(factory, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE):
        return Make(factory, None)

    def make(camera: StereoCamera, noise: StereoNoise) -> StereoFilter:
        return make_with_common_options(factory, camera, noise, {}, USUAL).filter

    return Make(make, (REFERENCE_CAMERA, REFERENCE_NOISE))


def _takes(factory: Callable[..., StereoFilter], **arguments: object) -> bool:
    try:
        inspect.signature(factory).bind(**arguments)
    except TypeError:
        return False
    return True


def _started(make: Make) -> StereoFilter:
    stereo_filter = make()
    stereo_filter.reset(START)
    return stereo_filter


def _driven(make: Make, frames: int = 5) -> tuple[StereoFilter, StraightDrive]:
    stereo_filter = _started(make)
    drive = make.drive()
    _drive_on(stereo_filter, drive, range(frames))
    return stereo_filter, drive


def _drive_on(stereo_filter: StereoFilter, drive: StraightDrive, frames: range, scale: float = 1.0) -> None:
    for frame in frames:
        if frame:
            drive.predict(stereo_filter, frame, scale)
        stereo_filter.update(drive.observe(frame, scale))


def shown_arrays(stereo_filter: StereoFilter) -> tuple[FloatArray, ...]:
    """Everything a filter shows, as copies."""
    return tuple(_shown(stereo_filter).values())


def _shown(stereo_filter: StereoFilter) -> dict[str, FloatArray]:
    pose, velocity, landmarks = stereo_filter.pose, stereo_filter.velocity, stereo_filter.landmarks
    shown = {
        "position": pose.position,
        "orientation": pose.orientation,
        "pose covariance": pose.covariance,
        "linear velocity": velocity.linear,
        "angular velocity": velocity.angular,
        "velocity covariance": velocity.covariance,
        "ids of the map": landmarks.ids,
        "landmark positions": landmarks.positions,
        "landmark covariances": landmarks.covariances,
        "inverse distances": landmarks.inverse_distance,
        "their variances": landmarks.inverse_distance_variance,
    }
    return {name: np.array(array, dtype=np.float64) for name, array in shown.items()}


def _assert_same(
    what: str, first: Mapping[str, FloatArray], second: Mapping[str, FloatArray], tolerance: float = TOLERANCE
) -> None:
    """Raise where arrays differ by more than `tolerance` of their largest entry; `what` begins the sentence."""
    for name, a in first.items():
        b = second[name]
        require(a.shape == b.shape, f"{what}: {name} has shape {a.shape}, then {b.shape}")
        finite = np.isfinite(a) & np.isfinite(b)
        alike = finite | (a == b) | (np.isnan(a) & np.isnan(b))
        require(alike.all(), f"{what}: {name} is finite in one and not in the other")
        apart = float(np.abs(a[finite] - b[finite]).max(initial=0.0))
        # A place near the origin is as good as one a metre away; a covariance has no such scale.
        least = 0.0 if "covariance" in name or "variance" in name else 1.0
        allowed = tolerance * max(float(np.abs(a[finite]).max(initial=0.0)), least)
        require(apart <= allowed, f"{what}: {name} differs by {apart:.2g}, more than {allowed:.2g}")


def _assert_covariance(name: str, covariance: FloatArray, *, definite: bool) -> None:
    fault = fault_of(covariance, definite=definite)
    require(fault is None, f"{name} {fault}")


def assert_healthy(stereo_filter: StereoFilter) -> None:
    """Raise an AssertionError if a belief is not finite, or a covariance not positive definite.

    That of the pose is looked at as it is shown and as `pose_error` claims it for the NEES.
    """
    pose, velocity = stereo_filter.pose, stereo_filter.velocity
    require(np.isfinite(np.concatenate([pose.position, pose.orientation])).all(), "pose is not finite")
    require(np.isfinite(np.concatenate([velocity.linear, velocity.angular])).all(), "velocity is not finite")
    require(abs(np.linalg.norm(pose.orientation) - 1) < 1e-9, "orientation is not a unit quaternion")
    _assert_covariance("pose covariance", pose.covariance, definite=True)
    _assert_covariance("velocity covariance", velocity.covariance, definite=False)
    error, claimed = stereo_filter.pose_error(pose.position, pose.orientation)
    require(np.isfinite(error).all(), "pose_error()[0] is not finite")
    _assert_covariance("covariance of pose_error", claimed, definite=True)
    landmarks = stereo_filter.landmarks
    located = np.isfinite(landmarks.positions).all(axis=1)
    _assert_covariance("covariance of a landmark", landmarks.covariances[located], definite=False)
    require((landmarks.inverse_distance_variance >= 0).all(), "an inverse distance has negative variance")


def check_interface(make: Make) -> None:
    """It is a StereoFilter with a camera and a noise."""
    stereo_filter = make()
    require(isinstance(stereo_filter, StereoFilter), f"got {type(stereo_filter).__name__}")
    require(isinstance(stereo_filter.camera, StereoCamera), "camera must be a StereoCamera")
    require(isinstance(stereo_filter.noise, StereoNoise), "noise must be a StereoNoise")


def check_reset(make: Make) -> None:
    """Reset puts the belief where it was told, with an empty map."""
    stereo_filter, _ = _driven(make)
    orientation = np.array([0.1, -0.2, 0.3, 0.9])
    orientation /= np.linalg.norm(orientation)
    covariance = np.diag(np.linspace(0.1, 1.2, 12))
    stereo_filter.reset(
        Start(np.array([1, 2, 3]), orientation, np.array([4, 5, 6]), np.array([0.1, 0.2, 0.3]), covariance)
    )
    pose, velocity = stereo_filter.pose, stereo_filter.velocity
    require(np.allclose(pose.position, (1, 2, 3)), f"position is {pose.position}")
    require(np.allclose(np.abs(pose.orientation @ orientation), 1), f"orientation is {pose.orientation}")
    require(np.allclose(velocity.linear, (4, 5, 6)), f"linear velocity is {velocity.linear}")
    require(np.allclose(velocity.angular, (0.1, 0.2, 0.3)), f"angular velocity is {velocity.angular}")
    require(np.allclose(pose.covariance, covariance[:6, :6]), "pose covariance is not the one given")
    require(np.allclose(velocity.covariance, covariance[6:, 6:]), "velocity covariance is not the one given")
    require(len(stereo_filter.landmarks.ids) == 0, "the map is not empty")


def check_shapes(make: Make) -> None:
    """Beliefs, forecast and pose error have the documented shapes and types."""
    stereo_filter, drive = _driven(make)
    pose, velocity, landmarks = stereo_filter.pose, stereo_filter.velocity, stereo_filter.landmarks
    error, covariance = stereo_filter.pose_error(drive.position(4), (0, 0, 0, 1))
    forecast = stereo_filter.forecast()
    n = len(landmarks.ids)
    expected = {
        "pose.position": (pose.position, (3,)),
        "pose.orientation": (pose.orientation, (4,)),
        "pose.covariance": (pose.covariance, (6, 6)),
        "velocity.linear": (velocity.linear, (3,)),
        "velocity.angular": (velocity.angular, (3,)),
        "velocity.covariance": (velocity.covariance, (6, 6)),
        "landmarks.positions": (landmarks.positions, (n, 3)),
        "landmarks.covariances": (landmarks.covariances, (n, 3, 3)),
        "landmarks.inverse_distance": (landmarks.inverse_distance, (n,)),
        "landmarks.inverse_distance_variance": (landmarks.inverse_distance_variance, (n,)),
        "pose_error()[0]": (error, (6,)),
        "pose_error()[1]": (covariance, (6, 6)),
        "forecast().uvd": (forecast.uvd, (len(forecast.ids), 3)),
        "forecast().S": (forecast.S, (len(forecast.ids), 3, 3)),
    }
    for name, (array, shape) in expected.items():
        require(array.shape == shape, f"{name} has shape {array.shape}, not {shape}")
        require(array.dtype == np.float64, f"{name} is {array.dtype}, not float64")
    require(isinstance(pose, PoseBelief), f"pose is a {type(pose).__name__}")
    require(isinstance(forecast, Forecast), f"forecast returned a {type(forecast).__name__}")
    require(landmarks.ids.dtype == np.int64, f"landmarks.ids is {landmarks.ids.dtype}, not int64")
    require((np.diff(landmarks.ids) > 0).all(), "landmarks.ids is not ascending")
    require(forecast.in_view.dtype == bool, "forecast().in_view is not boolean")


def check_covariances(make: Make) -> None:
    """Covariances are symmetric and positive definite all along a drive."""
    stereo_filter = _started(make)
    drive = make.drive()
    for frame in range(LONGEST_DELAY):
        _drive_on(stereo_filter, drive, range(frame, frame + 1))
        assert_healthy(stereo_filter)
        forecast = stereo_filter.forecast()
        usable = forecast.in_view & np.isfinite(forecast.uvd).all(axis=1)
        _assert_covariance("forecast S", forecast.S[usable], definite=True)
        innovation_excess = forecast.S[usable] - stereo_filter.noise.R
        _assert_covariance("forecast S less the noise R", innovation_excess, definite=frame > 0)


def check_joint_covariance(make: Make) -> None:
    """The joint covariance is definite, and has those of pose and landmarks on its diagonal."""
    stereo_filter, _ = _driven(make)
    landmarks = stereo_filter.landmarks
    located = np.isfinite(landmarks.covariances).all(axis=(1, 2))
    joint = stereo_filter.joint_covariance(landmarks.ids[located])
    size = 6 + 3 * int(located.sum())
    require(joint.shape == (size, size), f"joint covariance is {joint.shape}, not {(size, size)}")
    _assert_covariance("joint covariance", joint, definite=True)
    claimed_blocks = [joint[:6, :6], *(joint[first : first + 3, first : first + 3] for first in range(6, size, 3))]
    expected_blocks = [stereo_filter.pose.covariance, *landmarks.covariances[located]]
    for place, (block, marginal) in enumerate(zip(claimed_blocks, expected_blocks, strict=True)):
        off = np.abs(block - marginal).max() / np.abs(marginal).max()
        of = f"landmark {landmarks.ids[located][place - 1]}" if place else "the pose"
        require(off < 1e-9, f"the joint covariance of {of} differs from its own by {off:.3g} of it")


def check_prediction_loses_certainty(make: Make) -> None:
    """Predicting makes the pose less certain, and moves it by velocity times dt."""
    for dt in (DT, 0.3 * DT):
        stereo_filter, drive = _started(make), make.drive(steps=(dt,))
        before = np.trace(stereo_filter.pose.covariance)
        drive.predict(stereo_filter, 1, 0.0)
        require(np.trace(stereo_filter.pose.covariance) > before, "the pose covariance did not grow")
        moved = stereo_filter.pose.position
        as_expected = np.allclose(moved, drive.position(1), atol=1e-9)
        require(as_expected, f"moved to {moved} in {dt:g} s, not to {drive.position(1)}")


def check_pose_error(make: Make) -> None:
    """The pose error is that of the pose, with its covariance, and asking for it changes nothing."""
    stereo_filter, drive = _driven(make)
    before = _shown(stereo_filter)
    blind_pose_error(stereo_filter, drive.position(4), drive.orientation)
    stereo_filter.pose_error(drive.position(4), drive.orientation)
    _assert_same("pose_error changed the state", before, _shown(stereo_filter), 0.0)
    never_asked, _ = _driven(make)
    for one in (stereo_filter, never_asked):
        _drive_on(one, drive, range(5, 7))
    _assert_same("after pose_error it goes another way", _shown(never_asked), _shown(stereo_filter), 0.0)


def check_accuracy(make: Make) -> None:
    """The pose follows the truth where measurements are nearly exact."""
    stereo_filter, drive = _started(make), make.drive()
    _drive_on(stereo_filter, drive, range(10), scale=0.01)
    error = _error_of(stereo_filter, drive.position(9), drive.orientation)
    require(np.abs(error[:3]).max() < 0.05, f"position error {error[:3]} m")
    require(np.abs(error[3:]).max() < 0.01, f"rotation error {error[3:]} rad")


def _error_of(stereo_filter: StereoFilter, position: FloatArray, orientation: FloatArray) -> FloatArray:
    """Error of its pose as of `PoseBelief`, (6,)."""
    pose = stereo_filter.pose
    turn = rotations.log(rotations.matrix(pose.orientation).T @ rotations.matrix(orientation))
    return np.concatenate([position - pose.position, turn])


def check_accuracy_of_long_drives(make: Make) -> None:
    """Over winding drives of ten seconds its errors are not many times those of inverse-depth."""
    rig = make.driven_rig
    errors, used = _errors_on_long_drives(make(), *rig)
    if not used:
        return  # a filter without a camera, such as dead reckoning, is as good as what it goes by
    for what, error, reference in zip(("position", "rotation"), errors, _errors_of_inverse_depth(*rig), strict=True):
        factor = error / reference
        require(factor < WORST_FACTOR, f"{what} errors are {factor:.1f} times those of inverse-depth")


@lru_cache(maxsize=4)
def _errors_of_inverse_depth(camera: StereoCamera, noise: StereoNoise) -> tuple[float, float]:
    usual = make_with_common_options("inverse-depth", camera, noise, {}, USUAL).filter
    return _errors_on_long_drives(usual, camera, noise)[0]


def _errors_on_long_drives(
    stereo_filter: StereoFilter, camera: StereoCamera, noise: StereoNoise
) -> tuple[tuple[float, float], bool]:
    """Root mean square errors of position, m, and rotation, rad; and whether it rejected less than all it was given."""
    errors, used = [], False
    for seed in range(2):
        drive = WindingDrive.simulated(camera, noise, seed)
        stereo_filter.reset(
            Start(
                linear_velocity=drive.linear_velocity,
                angular_velocity=drive.angular_velocity,
                covariance=START_COVARIANCE,
            )
        )
        for number, frame in enumerate(drive.frames):
            if number:
                predict_step(stereo_filter, DT, frame.odometry, frame.inertial)
            used |= _has_used(stereo_filter.update(frame.observation), frame.observation)
            errors.append(_error_of(stereo_filter, frame.position, frame.orientation))
    squared = np.square(errors).reshape(-1, 2, 3).sum(axis=2)
    position, rotation = np.sqrt(squared.mean(axis=0)).tolist()
    return (position, rotation), used


def _has_used(report: UpdateReport, observation: StereoObservation) -> bool:
    return set(report.rejected.tolist()) != set(observation.ids.tolist())


def check_confidence(make: Make) -> None:
    """Over twenty drives with matched noise its covariances match its errors."""
    _assert_consistent(make, [make.drive(seed) for seed in range(20)])


def check_other_rig(make: Make) -> None:
    """Covariances match errors with another camera and noise, another start and unequal steps, too."""
    if make.rig is None:
        return  # it brings its own
    elsewhere = Start(
        np.array([20.0, -3.0, 8.0]), OTHER_ORIENTATION, SPEED * OTHER_HEADING, np.zeros(3), START_COVARIANCE
    )
    other = Make(make.factory, OTHER_RIG)
    _assert_consistent(other, [other.drive(seed, elsewhere, (0.06, 0.14, 0.1)) for seed in range(20)])


def _assert_consistent(make: Make, drives: Sequence[StraightDrive]) -> None:
    """Raise where the NEES of pose, velocity or map after six frames says that covariances are not those of errors.

    The median landmark counts: the errors of a far one in XYZ are not Gaussian. A filter that delays its updates, or
    has no camera, may be as cautious as it likes: this drive is smoother than what it must reckon with.
    """
    values: dict[str, list[FloatArray]] = {"pose": [], "velocity": [], "forecast": [], "landmark": []}
    used = False
    for drive in drives:
        stereo_filter = make()
        stereo_filter.reset(drive.start)
        _drive_on(stereo_filter, drive, range(5))
        drive.predict(stereo_filter, 5)
        used |= _has_used(stereo_filter.update(observation := drive.observe(5)), observation)
        error, covariance = blind_pose_error(stereo_filter, drive.position(5), drive.orientation)
        _assert_covariance("covariance of pose_error", covariance, definite=True)
        values["pose"].append(nees(error[None], covariance[None]) / 6.0)
        velocity = stereo_filter.velocity
        error = np.concatenate([drive.start.linear_velocity - velocity.linear, -velocity.angular])
        values["velocity"].append(nees(error[None], velocity.covariance[None]) / 6.0)
        forecast, landmarks = stereo_filter.forecast(), stereo_filter.landmarks
        error = drive.camera.project(drive.points_c[forecast.ids] - drive.driven(5)) - forecast.uvd
        values["forecast"].append(nees(error, forecast.S - stereo_filter.noise.R) / 3.0)
        values["landmark"].append(nees(drive.points[landmarks.ids] - landmarks.positions, landmarks.covariances) / 3.0)
    bounded_below = used and not _delays(make)
    for what, several in values.items():
        each = np.concatenate(several)
        each = each[np.isfinite(each)]  # a velocity or a map may be known exactly
        if not len(each):
            continue
        if what in ("pose", "velocity"):
            label, value = f"mean {what}", float(np.mean(each))
        else:
            label, value = f"median {what}", float(np.median(each)) * 3.0 / chi_square_quantile(0.5, 3)
        label += f" NEES / dof {value:.2g}, expected 1"
        least = LEAST_NEES_OF_FORECASTS if what == "forecast" else LEAST_NEES
        require(value < GREATEST_NEES, f"overconfident ({label})")
        require(value > least or not bounded_below, f"underconfident ({label})")


def _told(report: UpdateReport) -> list[int]:
    """The landmarks that a report says something of, those that have left the map aside."""
    parts = (report.updated, report.gated, report.behind_camera, report.failed, report.initialised, report.rejected)
    return [i for part in parts for i in part.tolist()]


def _delays(make: Make) -> bool:
    """Whether reports are of other frames than their own, too: a filter with delayed updates."""
    stereo_filter = _started(make)
    drive = make.drive()
    delays: list[list[int]] = []
    sight_delays: list[list[int]] = []
    for observation in [*(drive.observe(frame) for frame in range(5)), _EMPTY]:  # in the last one all tracks end
        if sight_delays:
            drive.predict(stereo_filter, len(sight_delays))
        delays.append(sorted(_told(stereo_filter.update(observation))))
        sight_delays.append(sorted(observation.ids.tolist()))
    return any(delays) and delays != sight_delays


def check_report(make: Make) -> None:
    """Reports account for every measurement, in the update of its frame or, where updates are delayed, later."""
    delayed = _delays(make)
    stereo_filter = _started(make)
    drive = make.drive()
    observations = [drive.observe(frame) for frame in range(6)]
    # Three measurements far off, and three that were never seen before.
    ids, uvd = observations[-1].ids.copy(), observations[-1].uvd.copy()
    uvd[:3, 0] += 200.0
    ids[-3:] += 1000
    observations[-1] = StereoObservation(ids, uvd)
    seen_counts: Counter[int] = Counter()
    reported_counts: Counter[int] = Counter()
    for observation in observations + [_EMPTY] * (LONGEST_DELAY if delayed else 0):
        if seen_counts:
            drive.predict(stereo_filter, 1)
        silent = not reported_counts and not len(stereo_filter.landmarks.ids)
        report = stereo_filter.update(observation)
        require(isinstance(report, UpdateReport), f"update returned {type(report).__name__}")
        now = _told(report)
        seen_counts.update(observation.ids.tolist())
        reported_counts.update(now)
        require(len(now) == len(set(now)), "an id is reported twice")
        require(set(now) <= set(seen_counts), "an id is reported that was not observed")
        require(
            reported_counts <= seen_counts,
            f"ids {sorted(reported_counts - seen_counts)[:5]} are reported more often than they were observed",
        )
        require(0 <= report.nis < np.inf, f"nis is {report.nis}")
        if not delayed and not silent:
            missing = set(observation.ids.tolist()) - set(now)
            require(not missing, f"ids {sorted(missing)[:5]} were observed and are not in the report")
    if delayed:
        never = set(seen_counts) - set(reported_counts)
        require(not never, f"ids {sorted(never)[:5]} were observed and are in no report {LONGEST_DELAY} frames later")


def check_order(make: Make) -> None:
    """The order of the landmarks in an observation does not matter."""
    first, second = _started(make), _started(make)
    drive = make.drive()
    rng = np.random.default_rng(7)
    for frame in range(6):
        observation = drive.observe(frame)
        if frame:
            drive.predict(first, frame)
            drive.predict(second, frame)
        first.update(observation)
        second.update(observation.select(rng.permutation(len(observation))))
    _assert_same("in another order", _shown(first), _shown(second))


def check_determinism(make: Make) -> None:
    """The same input gives the same bits, in a new filter and after reset."""
    first, drive = _driven(make)
    second, _ = _driven(make)
    _assert_same("two filters differ", _shown(first), _shown(second), 0.0)
    second.reset(START)
    _drive_on(second, drive, range(5))
    _assert_same("after reset it does not start afresh", _shown(first), _shown(second), 0.0)


def check_bad_input(make: Make) -> None:
    """Bad input raises ValueError and leaves the state unchanged."""
    stereo_filter, _ = _driven(make)
    before = _shown(stereo_filter)
    nan3 = (np.nan, 0.0, 0.0)
    attempts: dict[str, Callable[[], object]] = {
        "predict(0)": lambda: stereo_filter.predict(0.0),
        "predict(-0.1)": lambda: stereo_filter.predict(-0.1),
        "predict(nan)": lambda: stereo_filter.predict(float("nan")),
        "predict(inf)": lambda: stereo_filter.predict(float("inf")),
        "predict with a wrong odometry": lambda: stereo_filter.predict(DT, odometry=np.zeros(6)),  # type: ignore[arg-type]
        "update(None)": lambda: stereo_filter.update(None),  # type: ignore[arg-type]
        "reset with a position": lambda: stereo_filter.reset((0.0, 0.0, 0.0)),  # type: ignore[arg-type]
        "forecast of an unknown id": lambda: stereo_filter.forecast([10**9]),
        "pose_error with NaN": lambda: stereo_filter.pose_error(nan3, (0, 0, 0, 1)),
    }
    if "inertial" in inspect.signature(stereo_filter.predict).parameters:
        attempts["predict with wrong inertial samples"] = lambda: stereo_filter.predict(DT, inertial=np.zeros(6))  # type: ignore[arg-type]
    for name, attempt in attempts.items():
        try:
            attempt()
        except ValueError:
            pass
        except Exception as error:  # the contract is ValueError and nothing else
            raise AssertionError(f"{name} raised {type(error).__name__} instead of ValueError") from error
        else:
            raise AssertionError(f"{name} raised nothing")
        _assert_same(f"{name} changed the state", before, _shown(stereo_filter))


def check_negative_disparity(make: Make) -> None:
    """Measurements with d <= 0 are legal, for new and for known landmarks."""
    stereo_filter, drive = _driven(make)
    for frame in (5, 6):
        observation = drive.observe(frame)
        uvd = observation.uvd.copy()
        uvd[:2, 2] = -0.5
        uvd[2, 2] = 0.0
        ids = observation.ids.copy()
        ids[:3] += 500
        uvd[3, 2] = -0.2
        drive.predict(stereo_filter, frame)
        stereo_filter.update(StereoObservation(ids, uvd))
        assert_healthy(stereo_filter)
        stereo_filter.forecast()


def check_empty_observation(make: Make) -> None:
    """A frame without measurements changes no pose, unless updates are delayed."""
    stereo_filter, drive = _driven(make)
    drive.predict(stereo_filter, 5)
    before = _shown(stereo_filter)
    report = stereo_filter.update(_EMPTY)
    after = _shown(stereo_filter)
    assert_healthy(stereo_filter)
    if _delays(make):
        return
    of_pose = ("position", "orientation", "pose covariance")
    _assert_same("the pose changed", {name: before[name] for name in of_pose}, after)
    require(not _told(report), "the report is not empty")
    require(report.nis_dof == 0, f"nis_dof is {report.nis_dof}")


def check_forget(make: Make) -> None:
    """A forgotten landmark is gone, the pose stays, and it can be seen again."""
    stereo_filter, drive = _driven(make)
    ids = stereo_filter.landmarks.ids
    if len(ids) == 0:
        return  # a filter without a map
    forgotten_ids = ids[::3]
    before = _shown(stereo_filter)
    stereo_filter.forget(forgotten_ids)
    require(not np.isin(forgotten_ids, stereo_filter.landmarks.ids).any(), "forgotten ids are still in the map")
    require(len(stereo_filter.landmarks.ids) == len(ids) - len(forgotten_ids), "other ids went too")
    covariance = {"pose covariance": before["pose covariance"]}
    _assert_same("the pose changed", covariance, _shown(stereo_filter))
    stereo_filter.forget(forgotten_ids)
    missing = set(forgotten_ids.tolist())
    for frame in range(5, 6 + (LONGEST_DELAY if _delays(make) else 0)):
        drive.predict(stereo_filter, frame)
        missing -= set(stereo_filter.update(drive.observe(frame)).initialised.tolist())
    require(not missing, "forgotten ids were not started again")
    assert_healthy(stereo_filter)


def check_snapshots(make: Make) -> None:
    """Beliefs are snapshots: writing into them does not touch the filter."""
    stereo_filter, _ = _driven(make)
    before = _shown(stereo_filter)
    for array in (
        stereo_filter.pose.covariance,
        stereo_filter.pose.position,
        stereo_filter.landmarks.positions,
    ):
        if array.flags.writeable:
            array[...] = 1e3
    _assert_same("the filter's state changed", before, _shown(stereo_filter))


def check_copy(make: Make) -> None:
    """A deep copy goes its own way to the same result."""
    stereo_filter, drive = _driven(make)
    twin = copy.deepcopy(stereo_filter)
    frozen = _shown(stereo_filter)
    _drive_on(twin, drive, range(5, 8))
    _assert_same("driving the copy moved the original", frozen, _shown(stereo_filter))
    _drive_on(stereo_filter, drive, range(5, 8))
    _assert_same("copy and original differ", _shown(stereo_filter), _shown(twin))


CHECKS: tuple[Callable[[Make], None], ...] = (
    check_interface,
    check_reset,
    check_shapes,
    check_covariances,
    check_joint_covariance,
    check_prediction_loses_certainty,
    check_pose_error,
    check_accuracy,
    check_accuracy_of_long_drives,
    check_confidence,
    check_other_rig,
    check_report,
    check_order,
    check_determinism,
    check_bad_input,
    check_negative_disparity,
    check_empty_observation,
    check_forget,
    check_snapshots,
    check_copy,
)
