"""What holds for every test: it leaves nothing behind in the packages."""

import signal
import sys

import pytest

PACKAGES = ("filters", "stereo_slam_env")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell leaves it to what it starts in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _patched_names_are_not_kept():
    """Fail where a module was imported during the test and took over a name that the test had patched elsewhere.

    `from module import name` at the top of such a module would keep the patch for all tests that follow.
    """
    before = set(sys.modules)
    yield
    kept = [
        f"{module}.{name}"
        for module in sys.modules.keys() - before
        if module.partition(".")[0] in PACKAGES
        for name, value in vars(sys.modules[module]).items()
        if str(getattr(value, "__module__", None)).startswith("tests.")
    ]
    assert not kept, f"{', '.join(kept)} is the test's own: patch it where it is used, or make what it stands for"
