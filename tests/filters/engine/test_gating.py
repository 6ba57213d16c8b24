"""The chi-square gate."""

from __future__ import annotations

import pytest

from filters.contract.noise import gate_limit


@pytest.mark.parametrize(("dof", "limit"), [(2, 9.210), (3, 11.345), (4, 13.277)])
def test_limits_are_the_tabulated_ones(dof: int, limit: float) -> None:
    assert gate_limit(0.99, dof) == pytest.approx(limit, abs=1e-3)
