"""Studies, pages, examples and templates use public names only: those that packages and rooms list (1 s)."""

import ast
import importlib
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
STUDIES = (ROOT / "studies", ROOT / "stereo_slam_env" / "paper")
OURS = ("filters", "stereo_slam_env")
ROOMS = list((ROOT / "stereo_slam_env").glob("*/__init__.pyi"))
OUTSIDE = {"numpy", "scipy", *sys.stdlib_module_names}
"""What studies may import beyond this project."""


def scripts(folder):
    """(place, code) of each module below a folder."""
    return [(path.relative_to(ROOT), path.read_text("utf-8")) for path in sorted(folder.rglob("*.py"))]


def blocks(*pages):
    """(place, code) of the Python blocks of pages, without prompts."""
    found = []
    for page in pages:
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL):
            found.append((page.relative_to(ROOT), re.sub(r"^(>>>|\.\.\.) ?", "", block, flags=re.MULTILINE)))
    return found


def imports(code):
    """(module, name) of each import; name None where the module itself is imported."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "a relative import"
            yield from ((node.module, alias.name) for alias in node.names)


def is_room(module):
    """Whether this is a package of the project, or one directly in it, with a list of public names."""
    package, _, room = module.partition(".")
    return package in OURS and "." not in room and hasattr(importlib.import_module(module), "__all__")


def is_public(module, name):
    """Whether the list of a room has the name; a room itself is public, too."""
    if not is_room(module):
        return False
    return name is None or name in importlib.import_module(module).__all__ or (ROOT / "stereo_slam_env" / name).is_dir()


def deep_imports(sources):
    """What the sources import of this project that is not public."""
    return [
        f"{place}: {module}{f'.{name}' if name else ''}"
        for place, code in sources
        for module, name in imports(code)
        if module.partition(".")[0] in OURS and not is_public(module, name)
    ]


def test_studies_use_public_names_only():
    deep = [found for folder in STUDIES for found in deep_imports(scripts(folder))]
    assert [found for found in deep if not found.split(": ")[1].startswith("stereo_slam_env.paper")] == []


def test_studies_need_numpy_and_scipy_only():
    packages = {
        module.partition(".")[0] for folder in STUDIES for _, code in scripts(folder) for module, _ in imports(code)
    }
    assert packages - OUTSIDE - {*OURS, "studies"} == set()


@pytest.mark.parametrize(
    "sources",
    [
        pytest.param(lambda: blocks(ROOT / "README.md"), id="readme"),
        pytest.param(lambda: blocks(*sorted((ROOT / "docs").rglob("*.md"))), id="docs"),
        pytest.param(lambda: scripts(ROOT / "examples"), id="examples"),
        pytest.param(lambda: scripts(ROOT / "templates"), id="templates"),
    ],
)
def test_what_users_read_uses_public_names_only(sources):
    assert deep_imports(sources()) == []


def test_a_deep_import_is_found():
    code = "from stereo_slam_env.benchmark.campaign import run_benchmark\nfrom filters import Hidden, make_filter\n"
    assert deep_imports([("page", code)]) == [
        "page: stereo_slam_env.benchmark.campaign.run_benchmark",
        "page: filters.Hidden",
    ]


@pytest.mark.parametrize("room", [*OURS, *sorted(f"stereo_slam_env.{stub.parent.name}" for stub in ROOMS)])
def test_every_public_name_is_there(room):
    module = importlib.import_module(room)
    assert [name for name in module.__all__ if not hasattr(module, name)] == []
