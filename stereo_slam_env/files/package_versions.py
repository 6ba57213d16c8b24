"""Versions of the installed packages that a result depends on."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

_DISTRIBUTIONS = {"pybullet": ("pybullet", "pybullet-arm64")}
"""Those of which one brings the package, where it is not the one of the same name alone."""


def version_of(package: str) -> str:
    """Version of a package, or "not installed"."""
    for distribution in _DISTRIBUTIONS.get(package, (package,)):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return "not installed"
