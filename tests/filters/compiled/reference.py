"""A filter on the compiled engine beside the same filter on NumPy, over a drive."""

from __future__ import annotations

import numpy as np
import pytest

from filters import BodyVelocity, StereoEKF, StereoObservation, UpdateReport
from filters.compiled import frame
from filters.compiled.engine import CompiledEngine, Observations
from filters.compiled.stereo_ekf import filter_state, joint_state, recipe_of

from ..drives import DT, Frame
from ..engine.beliefs import assert_same_belief, make

NAMES = {"updated": frame.USED, "behind_camera": frame.BEHIND, "gated": frame.GATED, "failed": frame.FAILED}
NAMES |= {"initialised": frame.STARTED, "rejected": frame.REJECTED}


def packed(slam: StereoEKF, observation: StereoObservation) -> Observations:
    """The measurements of one filter."""
    o = observation.ordered()
    right = o.v_right is not None
    return Observations(
        seen=np.ones(1, dtype=bool),
        offsets=np.array([0, len(o)]),
        ids=o.ids,
        uvd=o.uvd,
        R=o.covariances(slam.noise),
        with_right=np.array([right]),
        v_right=o.v_right,
    )


def engine_of(slam: StereoEKF, **other: object) -> CompiledEngine:
    """A compiled engine with the filter's state."""
    recipe = recipe_of(slam)
    assert recipe is not None
    engine = CompiledEngine(recipe)
    engine.load(0, filter_state(slam.state, recipe))
    return engine


def predicted(engine: CompiledEngine, dt: float, odometry: BodyVelocity | None) -> None:
    if odometry is None:
        engine.predict(np.array([dt]))
        return
    values = np.concatenate([odometry.linear, odometry.angular])[None]
    engine.predict(np.array([dt]), np.ones(1, dtype=bool), values, np.array(odometry.covariance)[None])


def assert_same_report(ids: np.ndarray, outcome: object, report: UpdateReport) -> None:
    for name, fate in NAMES.items():
        np.testing.assert_array_equal(ids[outcome.fates == fate], getattr(report, name), err_msg=name)
    np.testing.assert_array_equal(np.sort(outcome.dropped[0]), np.sort(report.dropped))
    assert outcome.dof[0] == report.nis_dof
    assert outcome.nis[0] == pytest.approx(report.nis, rel=1e-8, abs=1e-12)


def assert_both_agree(
    frames: list[Frame], odometry: BodyVelocity | None = None, tolerance: float = 1e-10, **options: object
) -> list[UpdateReport]:
    """Reports to the id, beliefs to the tolerance; gives the reports of NumPy."""
    slam = make(**{"gate": 0.99, **options})
    engine = engine_of(slam)
    reports = []
    for number, seen in enumerate(frames):
        if number:
            slam.predict(DT, odometry)
            predicted(engine, DT, odometry)
        reports.append(slam.update(seen.observation))
        measured = packed(slam, seen.observation)
        assert_same_report(measured.ids, engine.update(measured), reports[-1])
    assert_same_belief(slam.with_state(joint_state(engine, 0, slam.state)), slam, tolerance)
    return reports
