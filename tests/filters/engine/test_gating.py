"""The chi-square gate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from filters.engine import gating


@pytest.mark.parametrize(("dof", "limit"), [(2, 9.210), (3, 11.345), (4, 13.277)])
def test_limits_are_the_tabulated_ones(dof: int, limit: float) -> None:
    assert gating.gate_limit(0.99, dof) == pytest.approx(limit, abs=1e-3)


@pytest.mark.parametrize("dof", [2, 3, 4])
def test_distances_of_gaussian_innovations_are_chi_square(dof: int) -> None:
    rng = np.random.default_rng(dof)
    root = rng.standard_normal((dof, dof)) + 2 * np.eye(dof)
    innovations = rng.standard_normal((20_000, dof)) @ root.T
    distances = gating.squared_distances(innovations, np.broadcast_to(root @ root.T, (20_000, dof, dof)))
    for probability in (0.5, 0.9, 0.99):
        share = (distances <= chi2.ppf(probability, dof)).mean()
        assert abs(share - probability) < 4 * np.sqrt(probability * (1 - probability) / 20_000)


def test_each_innovation_is_judged_by_its_own_covariance() -> None:
    S = np.stack([np.eye(2), 100.0 * np.eye(2)])
    assert gating.passes(np.array([[5.0, 0.0], [5.0, 0.0]]), S, 9.21).tolist() == [False, True]


def test_what_is_not_a_number_does_not_pass() -> None:
    assert not gating.passes(np.array([[np.nan, 0.0]]), np.eye(2)[None], 9.21).any()


def test_no_innovation_is_no_error() -> None:
    assert gating.passes(np.zeros((0, 3)), np.zeros((0, 3, 3)), 11.3).shape == (0,)
