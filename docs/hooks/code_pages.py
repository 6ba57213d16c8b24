"""Pages of the manual for the code it links to.

The Markdown files link to code as a plain view of the repository wants it, relative and out of `docs/`
(`../examples/write_a_filter.py`), or name it (`filters/geometry/camera.py` in code style). A site of its own has no
such files. So each file that is linked or named gets a page with its text, and the links are turned there.
"""

from __future__ import annotations

import logging
import posixpath
import re
from collections.abc import Callable
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
FOLDER = "code"
"""Where the pages of code are in the site."""
ENVIRONMENTS = ("drive", "gaze", "drive_gaze", "active_gaze", "closed_loop", "branches", "follow")
PAGES = {f"stereo_slam_env/envs/{name}.py": f"environments/{name}.md" for name in ENVIRONMENTS}
"""Code that is shown as something else than its text."""
LANGUAGES = {".py": "python", ".toml": "toml", ".md": "markdown", ".yml": "yaml"}

_LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")
_NAME = re.compile(r"(?<![\[`])`((?:filters|stereo_slam_env|tests|benchmarks|examples)/[\w./-]*\w)`(?!\])")
_FENCE = re.compile(r"^ *```.*?^ *```\s*?$", re.DOTALL | re.MULTILINE)

log = logging.getLogger("mkdocs.hooks.code_pages")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each file of code that a page links to or names, and for each file of a linked folder."""
    wanted: set[str] = set()
    for file in files.documentation_pages():
        _in_text(file.content_string, file.src_uri, wanted.add)
    for folder in sorted(name for name in wanted if (ROOT / name).is_dir()):
        wanted |= {f"{folder}/{path.name}" for path in _listed(folder)}
    for name in sorted(wanted - PAGES.keys()):
        files.append(File.generated(config, page_of(name), content=_content(name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links to code to its pages."""
    if page.file.src_uri.startswith(f"{FOLDER}/"):
        return markdown
    return _in_text(markdown, page.file.src_uri, lambda name: None)


def page_of(name: str) -> str:
    """Where in the site the code `name` (from the root of the repository) is shown."""
    return PAGES.get(name, f"{FOLDER}/{name}/index.md" if (ROOT / name).is_dir() else f"{FOLDER}/{name}.md")


def _in_text(markdown: str, source: str, found: Callable[[str], object]) -> str:
    """Turn the links of a page outside its fenced blocks, telling `found` what they lead to."""
    here = posixpath.dirname(source)

    def linked(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(here, match[1]))
        if not target.startswith("../"):
            return match[1]
        name = target.removeprefix("../")
        if not (ROOT / name).exists():
            log.warning("%s links to %s, which is not in the repository", source, name)
            return match[1]
        found(name)
        return posixpath.relpath(page_of(name), here or ".")

    def named(match: re.Match[str]) -> str:
        name = match[1].rstrip("/")
        if not (ROOT / name).is_file():
            return match[0]
        found(name)
        return f"[`{match[1]}`]({posixpath.relpath(page_of(name), here or '.')})"

    def turned(text: str) -> str:
        return _NAME.sub(named, _LINK.sub(linked, text))

    parts, end = [], 0
    for fence in _FENCE.finditer(markdown):
        parts += [turned(markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, turned(markdown[end:])])


def _listed(folder: str) -> list[Path]:
    return sorted(path for path in (ROOT / folder).iterdir() if path.suffix in LANGUAGES)


def _content(name: str) -> str:
    """The page of a file, or of a folder; not found by the search, which is for the manual."""
    settings = f"title: {posixpath.basename(name)}\nsearch:\n  exclude: true\nhide: [navigation, toc]"
    head = f"---\n{settings}\n---\n\n# `{name}`\n\n"
    path = ROOT / name
    if path.is_dir():
        return head + "".join(f"- [`{item.name}`]({item.name}.md)\n" for item in _listed(name))
    text = path.read_text(encoding="utf-8")
    fence = "`" * (3 + max((len(run) for run in re.findall(r"`{3,}", text)), default=0))
    return f"{head}{fence}{LANGUAGES.get(path.suffix, 'text')}\n{text}\n{fence}\n"
