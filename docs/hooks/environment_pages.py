"""A page for each Gymnasium environment, which is the docstring of its class."""

from __future__ import annotations

import ast
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

CODE = Path(__file__).resolve().parents[2] / "stereo_slam_env" / "envs"
MODULES = ("drive", "gaze", "drive_gaze", "active_gaze", "closed_loop", "branches", "follow")
ENVIRONMENTS = {module: f"StereoSlam/{module.title().replace('_', '')}-v0" for module in MODULES}
"""Module -> id, of the worlds, the benchmarks and Follow-v0."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add `environments/<module>.md`."""
    for module, name in ENVIRONMENTS.items():
        files.append(File.generated(config, f"environments/{module}.md", content=page(module, name)))
    return files


def page(module: str, name: str) -> str:
    """The Markdown page of an environment; nothing is imported for it."""
    tree = ast.parse((CODE / f"{module}.py").read_text(encoding="utf-8"))
    (described,) = (
        node
        for node in tree.body
        if isinstance(node, ast.ClassDef) and "## Description" in (ast.get_docstring(node) or "")
    )
    text = ast.get_docstring(described) or ""
    made = f'import gymnasium as gym\nimport stereo_slam_env  # registers the ids\n\nenv = gym.make("{name}")'
    first, _, rest = text.partition("\n")
    return f"# {name.partition('/')[2]}\n\n{first}\n\n```python\n{made}\n```\n{rest}\n"
