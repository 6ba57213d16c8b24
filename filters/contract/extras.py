"""Install commands of what a part of the distribution needs, and public names that say them.

Everything heavy is imported where it is used. So a machine that judges trajectories or runs filters can do without the
simulator, OpenCV, the charts and the compiler, and a name that needs one of them says which `pip install` brings it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import lazy_loader

DISTRIBUTION = "stereo-slam-env"

FIRST_WITHOUT_PYBULLET = (3, 14)
CORE = {
    "cv2": "opencv-python-headless<6",
    "filterpy": "filterpy",
    "jinja2": "jinja2",
    "joblib": "joblib",
    "llvmlite": "numba",
    "markupsafe": "jinja2",
    "numba": "numba",
    "PIL": "pillow",
    "pybullet": DISTRIBUTION,  # one of two distributions, by the machine: pip knows which
    "scipy": "scipy",
    "vl_convert": "vl-convert-python",
    "yaml": "pyyaml",
}
"""Requirement of the distribution that brings a module."""


def install_command(extra: str) -> str:
    """Command that adds an extra to the installation that runs, and leaves that as it is.

    pip takes the named distribution as it is installed (a copy, or an editable checkout) and fetches only what its
    extra lacks, so the command works in every folder and without the distribution on an index.
    """
    return f'{sys.executable} -m pip install "{DISTRIBUTION}[{extra}]"'


def require_module(module: str, extra: str) -> None:
    """Raise an `ImportError` that says how to install `module` with an extra, where it is missing."""
    if not is_installed(module):
        raise ImportError(f"{module} is missing: {install_command(extra)}")


def is_installed(module: str) -> bool:
    """Whether a module can be found, without importing it."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of a finder that refuses it
        return False


def explained(error: ModuleNotFoundError) -> ModuleNotFoundError:
    """The error, with the command that brings the missing module where that is one of `CORE`."""
    module = (error.name or "").partition(".")[0]
    requirement = CORE.get(module)
    if requirement is None:
        return error
    if module == "pybullet" and sys.version_info >= FIRST_WITHOUT_PYBULLET:
        remedy = 'there are no wheels for this Python: use renderer="gl" and physics="exact", or Python 3.11 to 3.13'
    else:
        remedy = f'{sys.executable} -m pip install "{requirement}"'
    message = f"{module} is missing: {remedy}"
    return ModuleNotFoundError(message, name=error.name)


def require_core(*modules: str) -> None:
    """Raise a `ModuleNotFoundError` that says how to install the first of these modules of `CORE` that is missing."""
    for module in modules:
        if not is_installed(module):
            raise explained(ModuleNotFoundError(name=module))


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The `__getattr__`, `__dir__` and `__all__` of a package whose stub lists its public names.

    A name is imported when it is first used; a `ModuleNotFoundError` says how to install what it needs.
    """
    load, names, listed = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            raise explained(error) from None

    return get, names, listed
