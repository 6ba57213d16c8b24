"""Beliefs of many combinations of parts and options, as an independent EKF in NumPy had them.

That EKF had dense blocks, LAPACK and no kernels, and was part of this package until both had agreed for long. Those of
unscented updates are of the kernels as plain Python, since sigma points lie along the symmetric root of P. Those of
first estimates with odometry are of `FirstEstimates` by its NumPy, which moves the linearisation point, and those of
a right camera that may be turned ("calib3") of `CalibratedPair` by its NumPy.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from .combinations import Case, combinations, figures, run_case

RECORDED = Path(__file__).with_name("golden_beliefs.npz")


@cache
def recorded() -> dict[str, np.ndarray]:
    with np.load(RECORDED) as file:
        names, numbers, offsets = file["names"].tolist(), file["numbers"], file["offsets"]
    return {name: numbers[offsets[i] : offsets[i + 1]] for i, name in enumerate(names)}


CASES = [case for case in combinations() if case.name in recorded()]


def test_every_recorded_combination_is_run() -> None:
    assert len(CASES) == len(recorded()) > 300


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_combination_believes_what_it_did(case: Case) -> None:
    slam, reports = run_case(case)
    np.testing.assert_allclose(figures(slam, reports, case.clones), recorded()[case.name], rtol=1e-10, atol=1e-9)
