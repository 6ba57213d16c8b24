"""A page for each notebook: its text, its code, and what it printed and showed when it was last run."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
_STYLED = re.compile(r"\x1b\[[0-9;]*m")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add `notebooks/NAME.md`, and the exercises as a page of code."""
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        open_it = (
            f'To open it: `pip install "stereo-slam-env[notebooks]" jupyterlab`, `jupyter lab notebooks/{path.name}`.\n'
        )
        content = f"{page(json.loads(path.read_text(encoding='utf-8')))}\n{open_it}"
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=content))
    code = (NOTEBOOKS / "exercises.py").read_text(encoding="utf-8")
    files.append(File.generated(config, "notebooks/exercises.md", content=f"# Exercises\n\n```python\n{code}```\n"))
    return files


def page(notebook: dict[str, Any]) -> str:
    """The Markdown page of a notebook."""
    parts: list[str] = []
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        parts += [shown for output in cell["outputs"] if (shown := _shown(output))]
    return "\n\n".join(parts) + "\n"


def _shown(output: dict[str, Any]) -> str:
    """What a cell printed, or what an object showed of itself."""
    data = output.get("data", {})
    if "text/html" in data:
        return f'<div class="shown">{"".join(data["text/html"])}</div>'
    text = _STYLED.sub("", "".join(output.get("text", data.get("text/plain", "")))).strip("\n")
    return f"```text\n{text}\n```" if text.strip() else ""
