"""Strapdown motion: right to the integral, consistent, and blind where nothing can be seen (20 s; slow ones 2 min)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from filters import CameraState, InertialSamples, StereoEKF, Strapdown, check_part, make_filter
from filters.geometry import symmetric

from ..dense import at_first_estimates, gamma
from ..drives import CAMERA, INDEPENDENT_PIXELS
from ..inertial_drives import (
    BIASES,
    DT,
    GRAVITY,
    SAMPLES,
    START_SIGMAS,
    UNIT,
    Journey,
    Path,
    driven,
    flown,
    measured,
    moving,
)

KNOWN = {"name": "strapdown", "sigma_gravity": 1e-4}


@pytest.mark.parametrize("part", [Strapdown(), Strapdown(sigma_mounting=0.01)], ids=["mounted", "mounting open"])
def test_the_part_is_right(part: Strapdown) -> None:
    assert "0 failed" in str(check_part(part))


def state_at(path: Path, t: float, motion: Strapdown) -> CameraState:
    """The true state, without biases."""
    at, R = path(np.array([t, t + 1e-5]))
    rate = (R[0].inv() * R[1]).as_rotvec() / 1e-5
    values = {variable.name: variable.value for variable in motion.variables}
    return CameraState(at[0], R[0].as_quat(), moving(path, np.array([t]))[0], rate, values)


@pytest.mark.parametrize("path", [driven, flown], ids=["drive", "flight"])
def test_exact_samples_lead_along_the_path(path: Path) -> None:
    """Two seconds at 200 Hz, with the lever arm; what is left is the motion within a sample."""
    motion = Strapdown()
    state, h = state_at(path, 0.3, motion), DT / SAMPLES
    for k in range(20):
        numbers = measured(path, 0.3 + k * DT + h * np.arange(SAMPLES + 1))
        given = InertialSamples(h * np.arange(1, SAMPLES + 1), numbers[:, :3], numbers[:, 3:], UNIT)
        state = motion.predict(state, DT, given).state
    at, R = path(np.array([2.3]))
    assert np.linalg.norm(state.position - at[0]) < 1e-3
    assert np.linalg.norm((Rotation.from_quat(state.orientation).inv() * R[0]).as_rotvec()) < 1e-4
    assert np.linalg.norm(state.linear_velocity - moving(path, np.array([2.3]))[0]) < 5e-3


def test_the_noise_of_a_step_is_that_of_a_fine_integration() -> None:
    """Every sample cut into fifty: the same mean motion, the same densities.

    Without a lever arm, by which the velocity of the camera has the noise of the last sample, however short that is.
    """
    unit = replace(UNIT, position=np.zeros(3))
    motion, rng = Strapdown(sigma_mounting=0.01), np.random.default_rng(0)
    rates, forces = rng.normal(0.0, 0.5, (SAMPLES, 3)), rng.normal([0.0, -9.8, 0.0], 2.0, (SAMPLES, 3))

    def after(parts: int) -> tuple[np.ndarray, ...]:
        times = DT * np.arange(1, parts * SAMPLES + 1) / (parts * SAMPLES)
        given = InertialSamples(times, np.repeat(rates, parts, axis=0), np.repeat(forces, parts, axis=0), unit)
        step = motion.predict(state_at(flown, 0.7, motion), DT, given)
        return step.F, step.Q, motion.numbers_of(step.state)

    rows = [*range(9), *range(12, 24)]  # the last sample stands for the angular velocity
    for coarse, fine in zip(after(1)[:2], after(50)[:2], strict=True):
        scale = np.sqrt(np.outer(np.diag(fine), np.diag(fine)))[np.ix_(rows, rows)]
        off = np.abs(coarse - fine)[np.ix_(rows, rows)] / np.where(scale > 0.0, scale, 1.0)
        assert off.max() < 0.02
    np.testing.assert_allclose(after(1)[2][:10], after(50)[2][:10], atol=1e-6)


def headed(error: str, seed: int) -> tuple[float, float]:
    """Information on a yaw about the start over its prior of .3 rad, after 10 s of flight, and the last NEES / 6."""
    sigmas = START_SIGMAS.copy()
    sigmas[:6] = 0.0, 0.0, 0.0, 1e-3, 0.3, 1e-3
    journey = Journey.along(flown, seed, 10.0, sigmas)
    prior = np.diag(np.repeat([1e-6, 0.3, 100.0, 0.05], 3) ** 2)  # a known direction of the velocity would be a compass
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark="shared-anchor", error=error, gate=None, motion=KNOWN)
    found = replace(journey, start=replace(journey.start, covariance=prior)).run(slam)
    state = slam.state
    yaw = gamma(at_first_estimates(state) if error == "first-estimates" else state) @ np.array([0.0, 1.0, 0.0])
    return 0.3**2 * float(yaw @ np.linalg.solve(symmetric.full(state.P), yaw)), float(np.mean(found[-20:]) / 6)


@pytest.mark.parametrize("error", ["so3", "left-invariant", "first-estimates", "right-invariant"])
def test_no_heading_is_learnt_by_a_consistent_error(error: str) -> None:
    """so3 claims to know a thousand times as much as there is to know, left-invariant errors fifty times."""
    information, last = headed(error, 0)
    if error in ("first-estimates", "right-invariant"):
        assert information == pytest.approx(1.0, abs=1e-3)
    else:
        assert information > (500.0 if error == "so3" else 20.0)
    assert (last < 2.0) == (error == "right-invariant")


def flight(seed: int, path: Path, **settings: object) -> tuple[StereoEKF, Journey, np.ndarray]:
    """A filter of the preset after 8 s, told a gravity that is .3 m/s^2 off per axis, the journey, and its NEES / 6."""
    told = GRAVITY + 0.3 * np.random.default_rng([seed, 1]).standard_normal(3)
    motion = {"name": "strapdown", "sigma_gravity": 0.3, "gravity": told.tolist(), **settings}
    slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS, gate=None, motion=motion)
    assert isinstance(slam, StereoEKF)
    journey = Journey.along(path, seed, 8.0)
    return slam, journey, journey.run(slam) / 6.0


def share(slam: StereoEKF, name: str, truth: np.ndarray) -> float:
    """Normalised squared error of a variable, over its size."""
    belief = slam.belief(name)
    off = belief.value - truth
    return float(off @ np.linalg.solve(belief.covariance, off)) / len(off)


@pytest.mark.parametrize(
    "runs", [8, pytest.param(50, marks=[pytest.mark.slow, pytest.mark.timeout(900)])], ids=["few", "many"]
)
@pytest.mark.parametrize("path", [driven, flown], ids=["drives", "flights"])
def test_it_is_consistent(path: Path, runs: int) -> None:
    """50 drives: NEES / 6 1.02, biases and gravity 1.0 and 1.1; 50 flights: .97, .9, 1.0 (bands of the few wider)."""
    found, biases, gravity = [], [], []
    for seed in range(runs):
        slam, journey, nees = flight(seed, path)
        found.append(nees[1:])
        biases.append(share(slam, "imu-bias", journey.steps[-1].biases))
        gravity.append(share(slam, "gravity", GRAVITY))
    single, mean = (chi2.ppf([0.025, 0.975], 6 * n) / (6 * n) for n in (1, runs))
    values = np.array(found)
    spread = np.sqrt(50 / runs)
    assert abs(values.mean() - 1.0) < 0.15 * spread
    assert ((values > single[0]) & (values < single[1])).mean() > (0.92 if runs == 50 else 0.85)
    over_runs = values.mean(axis=0)
    assert ((over_runs > mean[0]) & (over_runs < mean[1])).mean() > 0.85
    assert abs(np.mean(biases) - 1.0) < 0.3 * spread
    assert abs(np.mean(gravity) - 1.0) < 0.5 * spread


def test_a_mounting_that_is_off_is_found() -> None:
    """The stated orientation is 20 mrad off: without the variable the filter is overconfident."""
    journey = Journey.along(flown, 0, 8.0)
    off = Rotation.from_rotvec([0.02, -0.01, 0.015])
    stated = replace(UNIT, orientation=(off * Rotation.from_quat(UNIT.orientation)).as_quat())
    steps = tuple(replace(step, inertial=replace(step.inertial, unit=stated)) for step in journey.steps)
    found = {}
    for sigma in (0.0, 0.02):
        motion = {"name": "strapdown", "sigma_mounting": sigma}
        slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS, gate=None, motion=motion)
        assert isinstance(slam, StereoEKF)
        found[sigma] = replace(journey, steps=steps).run(slam)[-20:].mean() / 6.0
    belief = slam.belief("imu-mounting")
    assert found[0.02] < 3.0 < found[0.0]
    assert np.abs(belief.value + off.as_rotvec()).max() < 4.0 * np.sqrt(np.diag(belief.covariance).max())
    assert np.sqrt(np.diag(belief.covariance).max()) < 5e-3


def test_biases_of_the_prior_are_those_that_are_simulated() -> None:
    part = Strapdown()
    np.testing.assert_allclose(np.sqrt(np.diag(part.variables[0].covariance)), BIASES)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"gravity": (0.0, 9.81)}, r"^gravity must have shape \(3,\), got \(2,\)$"),
        ({"sigma_gravity": -1.0}, r"^sigma_gravity must be a finite number >= 0, got -1.0$"),
    ],
)
def test_wrong_settings_are_refused(setting: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Strapdown(**setting)  # type: ignore[arg-type]
