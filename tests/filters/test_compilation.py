"""Machine code is an option: without it nobody pays for it, and without Numba a filter says what is missing."""

from __future__ import annotations

import subprocess
import sys

import pytest
from filters.engine.arithmetic import NUMPY, arithmetic

from filters import make_filter
from filters.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.engine import arithmetic as arithmetic_module


def test_filters_do_not_import_numba_unless_asked_to() -> None:
    code = (
        "import sys, filters; from filters.conformance import REFERENCE_CAMERA as c, REFERENCE_NOISE as n;"
        "[filters.make_filter(name, camera=c, noise=n) for name in ('inverse-depth', 'shared-anchor', 'unscented')];"
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_default_is_numpy() -> None:
    assert arithmetic(compiled=False) is NUMPY
    assert make_filter("inverse-depth", camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE).parts.arithmetic is NUMPY


def test_without_numba_a_compiled_filter_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arithmetic_module, "find_spec", lambda name: None)
    message = r'^compiled must be False without Numba: .* -m pip install "stereo-slam-env\[fast\]"$'
    with pytest.raises(ValueError, match=message):
        make_filter("inverse-depth", camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE, compiled=True)


@pytest.mark.parametrize("value", [1, None, "yes"])
def test_the_option_is_a_boolean(value: object) -> None:
    with pytest.raises(ValueError, match="compiled must be True or False, got"):
        make_filter("inverse-depth", camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE, compiled=value)
