"""Reference of the public names: a page for each package that lists some, from the docstrings. Nothing is imported."""

from __future__ import annotations

import ast
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
ROOMS = sorted(stub.parent.name for stub in ROOT.glob("stereo_slam_env/*/__init__.pyi"))
PACKAGES = ("filters", "stereo_slam_env", *(f"stereo_slam_env/{room}" for room in ROOMS))
"""Folders whose stub is a list of public names."""
SUBJECTS = {"api": "Record, evaluate, compare", "envs": "Environments", "loop": "Run a filter"}
"""Titles of subjects that the name of the module does not tell."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add `api/<package>.md`."""
    for package in PACKAGES:
        files.append(File.generated(config, f"api/{dotted(package)}.md", content=page(package)))
    return files


def page(package: str) -> str:
    """The Markdown page of a package: what it is, and each public name by subject, or where that is described."""
    about = ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8")))
    if not about:
        raise ValueError(f"{package}/__init__.py needs a docstring, it begins the page of its names")
    own = places(package)
    elsewhere = [] if package == "stereo_slam_env" else [place for place in own if place in places("stereo_slam_env")]
    subjects: dict[str, list[str]] = {}
    for place in own:
        if place not in elsewhere:
            subject = place.removeprefix(f"{dotted(package)}.").partition(".")[0]
            subjects.setdefault(subject, []).append(f"::: {place}\n    options:\n      heading_level: 3")
    entries = [
        text
        for subject, names in sorted(subjects.items())
        for text in (f"## {SUBJECTS.get(subject, subject.replace('_', ' ').capitalize())}", *names)
    ]
    links = ", ".join(f"[`{place.rpartition('.')[2]}`][{place}]" for place in elsewhere)
    shared = [f"Also here: {links}."] if links else []
    return "\n\n".join([f"# {dotted(package)}", about, *shared, *entries]) + "\n"


def places(package: str) -> list[str]:
    """Full name of each public name of a package where it is defined, by the alphabet."""
    stub = ast.parse((ROOT / package / "__init__.pyi").read_text(encoding="utf-8"))
    found = [
        f"{dotted(package)}.{node.module}.{alias.name}"
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if not alias.name.startswith("_")
    ]
    return sorted(found, key=lambda place: place.rpartition(".")[2].lower())


def dotted(package: str) -> str:
    """Name of the package in a folder."""
    return package.replace("/", ".")
