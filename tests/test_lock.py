"""What the tests run with is pinned for each Python, within the bounds of users, and PyBullet by hash (< 1 s)."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ("3.11", "3.12", "3.13")
LINES = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
PINS = [Requirement(line.partition("#")[0]) for line in LINES if line.partition("#")[0].strip()]
BY_HASH = (ROOT / "constraints-pybullet.txt").read_text(encoding="utf-8")
(EXTRAS,) = re.findall(r"^EXTRAS := (\S+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def here(python, extra=""):
    machine = {"sys_platform": "linux", "platform_machine": "x86_64", "platform_system": "Linux"}
    return {"python_version": python, "python_full_version": f"{python}.0", "extra": extra, **machine}


def pinned(python):
    """Pins that hold for a version of Python, by name."""
    return [
        (canonicalize_name(pin.name), pin) for pin in PINS if pin.marker is None or pin.marker.evaluate(here(python))
    ]


def required(python):
    """Requirements of the distribution with the extras of `make test`."""
    optional = PROJECT["optional-dependencies"]
    lines = [*PROJECT["dependencies"], *(line for extra in EXTRAS.split(",") for line in optional[extra])]
    found = map(Requirement, lines)
    return [one for one in found if one.marker is None or one.marker.evaluate(here(python))]


@pytest.mark.parametrize("python", PYTHONS)
def test_every_requirement_is_pinned_once_and_within_its_bounds(python):
    pins = pinned(python)
    assert len(dict(pins)) == len(pins)
    for requirement in required(python):
        (specifier,) = dict(pins)[canonicalize_name(requirement.name)].specifier
        assert specifier.operator == "=="
        assert requirement.specifier.contains(specifier.version), requirement.name


def test_pins_say_nothing_of_where_packages_come_from():
    assert [
        line for line in [*LINES, *BY_HASH.splitlines()] if re.search(r"://[^/]*/|--(index|find)|file:", line)
    ] == []


@pytest.mark.parametrize("python", PYTHONS)
def test_pybullet_is_taken_by_hash_and_in_the_pinned_version(python):
    entries = [Requirement(entry) for entry in re.findall(r"^(pybullet[^\\]*)\\$", BY_HASH, re.MULTILINE)]
    (taken,) = [entry for entry in entries if entry.marker.evaluate(here(python))]
    assert dict(pinned(python))[taken.name].specifier == taken.specifier
    after = BY_HASH[BY_HASH.index(f"\n{taken.name}==") :].splitlines()[2:]
    assert re.fullmatch(r" +--hash=sha256:[0-9a-f]{64} ?\\?", after[0])


def test_users_have_open_lower_bounds_and_no_pins():
    for line in PROJECT["dependencies"]:
        assert not [one for one in Requirement(line).specifier if one.operator == "=="], line
        assert ">=" in line, line


def test_opencv_ends_before_the_next_major_version():
    (opencv,) = [Requirement(line) for line in PROJECT["dependencies"] if line.startswith("opencv")]
    assert all(opencv.specifier.contains(version) for version in ("4.9.0.80", "5.0.0.93"))
    assert not opencv.specifier.contains("6.0.0.1")
