"""What tests of several parts share."""

import sys

import pytest

from filters.contract.extras import install_command

from .third_party import third_party as third_party


@pytest.fixture(params=["moderngl", "EGL"])
def missing_gl(request, monkeypatch):
    """A machine without the one or the other: the remedy that every error has to name.

    The lack itself is made, not its report: a patched function would stay in modules that are first imported meanwhile.
    """
    from stereo_slam_env.rendering.renderers import renderer_identity

    renderer_identity.cache_clear()  # it does not look again once it found both
    if request.param == "moderngl":
        monkeypatch.setitem(sys.modules, "moderngl", None)
        return f"needs moderngl: {install_command('gl')}"
    pytest.importorskip("moderngl")
    monkeypatch.setenv("GLCONTEXT_LINUX_LIBEGL", "/nowhere/libEGL.so")
    return 'apt install libegl1 libgl1-mesa-dri, or use renderer="tiny"'
