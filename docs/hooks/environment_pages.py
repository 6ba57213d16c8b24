"""A page for each Gymnasium environment, which is the docstring of its class."""

from __future__ import annotations

import ast
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

CODE = Path(__file__).resolve().parents[2] / "stereo_slam_env" / "envs"
ENVIRONMENTS = {"drive": "StereoSlam/Drive-v0", "gaze": "StereoSlam/Gaze-v0", "drive_gaze": "StereoSlam/DriveGaze-v0"}
"""Module -> id."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add `environments/<module>.md`."""
    for module, name in ENVIRONMENTS.items():
        files.append(File.generated(config, f"environments/{module}.md", content=page(module, name)))
    return files


def page(module: str, name: str) -> str:
    """The Markdown page of an environment; nothing is imported for it."""
    tree = ast.parse((CODE / f"{module}.py").read_text(encoding="utf-8"))
    (described,) = (node for node in tree.body if isinstance(node, ast.ClassDef))
    text = ast.get_docstring(described)
    if not text:
        raise ValueError(f"{module}.py: class {described.name} needs a docstring, it is the page of the environment")
    made = f'import gymnasium as gym\nimport stereo_slam_env  # registers the ids\n\nenv = gym.make("{name}")'
    first, _, rest = text.partition("\n")
    return f"# {name.partition('/')[2]}\n\n{first}\n\n```python\n{made}\n```\n{rest}\n"
