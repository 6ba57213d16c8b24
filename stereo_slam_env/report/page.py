"""The page that reports are written on: self-contained, light and dark, printable, with live tables and charts.

A report is a list of sections, tables and drawings; only here they become markup and files.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import vl_convert
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

from filters.contract.validation import without_controls
from stereo_slam_env.benchmark.storage.run_files import holds_run
from stereo_slam_env.files.folders import own_files, remove_own_files, write_text
from stereo_slam_env.report.charts.axes import in_page_colours
from stereo_slam_env.report.charts.drawing import Chart
from stereo_slam_env.report.charts.saving import save_all
from stereo_slam_env.report.table import Column, Table, TableCell, latex_table

FIGURES, TABLES = "figures", "tables"
"""Folders of the figures, and of the tables as LaTeX, beside the page."""


@dataclass(frozen=True)
class Drawing:
    """A chart of a page, saved beside it as PNG and SVG."""

    name: str
    """Name of the files, and of the figure in the page: letters, digits, "_" and "-", unique in the page."""
    caption: str
    """One sentence of plain text: the caption, and what a screen reader says."""
    chart: Chart
    """Drawn with the colours of `axes`."""


@dataclass(frozen=True)
class Block:
    """Content below a heading."""

    heading: str
    content: Content
    folded: bool = False
    """Whether it is shown only on a click at the heading."""


@dataclass(frozen=True)
class Section:
    """Section of a page, which its contents list; one without contents is left out."""

    heading: str
    contents: Sequence[Content]
    guide: str = ""
    """How to read it, plain text."""
    kind: str = ""
    """CSS class: "screen" is not printed."""


Content = Markup | Table | Drawing | Block | Section
_KEPT_LIBRARY = Path(__file__).parent / "__pycache__" / f"vega-{version('vl-convert-python')}.js"


def html_page(*, title: str, subtitle: str, body: str) -> str:
    """Put a body into the page that all reports share.

    Parameters
    ----------
    title, subtitle : str
        Plain text.
    body : str
        Markup: sections, `figure_block`s, `table`s (of `page_sections`). Tables of class "sortable" sort.

    Returns
    -------
    str
        The HTML document; it needs no other file and no network.
    """
    return (
        _templates()
        .get_template("page.html")
        .render(
            title=without_controls(title),
            subtitle=without_controls(subtitle),
            contents=_contents(body),
            body=Markup(without_controls(body)),
            css=Markup(_resource("page.css")),
            library=Markup(_vega()) if 'class="chart-data"' in body else "",
            script=Markup(_resource("page.js")),
        )
    )


_FEWEST_LISTED = 3
_SECTION = re.compile(r'<section id="([^"]*)"[^>]*><h2>(.*?)</h2>')


def _contents(body: str) -> Markup:
    """Links to the sections of a page that has a few."""
    sections = [(Markup(heading), Markup(place)) for place, heading in _SECTION.findall(body)]
    return part("contents", sections) if len(sections) >= _FEWEST_LISTED else Markup()


def write_page(path: Path, *, title: str, subtitle: str, contents: Sequence[Content]) -> Path:
    """Write a page, whole or not at all, with its contents one below the other, in a folder that is made.

    Drawings go into `figures/`, tables that name a file into `tables/` beside it. Returns its path; a `ValueError` says
    that another page is there.
    """
    out = path.parent
    own_files(out, [path.name])
    blocks = figure_blocks(list(_drawings(contents)), out / FIGURES)
    body = Markup("\n").join(markup(content, out, blocks) for content in contents)
    write_text(path, html_page(title=title, subtitle=subtitle, body=body))
    return path


def markup(content: Content, out: Path | None = None, blocks: Mapping[str, Markup] = MappingProxyType({})) -> Markup:
    """Markup of a content; `blocks` are those of its drawings, and LaTeX files of its tables go into `out`."""
    match content:
        case Table():
            return on_page(content, out)
        case Drawing():
            return blocks[content.name]
        case Block():
            return part("folded" if content.folded else "titled", content.heading, markup(content.content, out, blocks))
        case Section():
            inside = [markup(one, out, blocks) for one in content.contents]
            return part("section", content.heading, content.guide, inside, content.kind) if any(inside) else Markup()
    return content


def _drawings(contents: Sequence[Content]) -> Iterator[Drawing]:
    for content in contents:
        match content:
            case Drawing():
                yield content
            case Block():
                yield from _drawings([content.content])
            case Section():
                yield from _drawings(content.contents)


def part(name: str, /, *arguments: Any, **named: Any) -> Markup:
    """A part of a page, a macro of `parts.html`; plain text is escaped there, `Markup` is not."""
    macro = getattr(_templates().get_template("parts.html").module, name)
    return Markup(macro(*arguments, **named).strip())


def figure_block(chart: Chart, name: str, description: str, folder: Path) -> Markup:
    """Save a chart as PNG and SVG, and return it as markup for a page."""
    return figure_blocks([Drawing(name, description, chart)], folder)[name]


def figure_blocks(drawings: Sequence[Drawing], folder: Path) -> dict[str, Markup]:
    """Save drawings as PNG and SVG, and return them as markup for a page.

    Parameters
    ----------
    drawings : sequence of Drawing
        Each with a name of its own.
    folder : Path
        Where `<name>.png` and `<name>.svg` go, beside the page: links in the page are relative to its parent.

    Returns
    -------
    dict of str to Markup
        By name, a `<figure>` with the drawing inline, and the chart that takes its place where there is JavaScript.
    """
    if not drawings:
        return {}
    folder.mkdir(parents=True, exist_ok=True)
    own_files(folder.parent, [f"{folder.name}/{one.name}{ending}" for one in drawings for ending in (".png", ".svg")])
    pictures = [(one.chart, (folder / f"{one.name}.png", folder / f"{one.name}.svg")) for one in drawings]
    blocks = {}
    for one, svg in zip(drawings, save_all(pictures), strict=True):
        # Inside a script element "<" could end it.
        data = json.dumps(one.chart.spec, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        blocks[one.name] = part(
            "figure",
            name=one.name,
            place=f"{folder.name}/{one.name}",
            description=one.caption,
            drawing=inline_svg(svg, one.name, one.caption),
            data=Markup(in_page_colours(data.replace("<", "\\u003c"))),
        )
    return blocks


def inline_svg(svg: str, name: str, description: str) -> Markup:
    """Turn an SVG document, drawn with the colours of `axes`, into an element that takes those of the page around it.

    `name` prefixes the ids inside, `description` is what a screen reader says. Nothing in it refers to the outside.
    """

    def of_page(found: re.Match[str]) -> str:
        tag = re.sub(
            r' (?:class|role|aria-[a-z]+|font-family|pointer-events|xmlns(?::\w+)?|version)="[^"]*"', "", found[0]
        )
        tag = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path[0]), tag)  # a tenth of a pixel
        tag = re.sub(r' id="([^"]*)"', rf' id="{name}-\1"', tag)
        return re.sub(r"url\(#(\w+)\)", rf"url(#{name}-\1)", tag)

    markup = re.sub(r"<[^>]*>", of_page, svg[svg.index("<svg") :])
    head, rest = markup.split(">", 1)
    width = re.search(r' width="([\d.]+)"', head)
    box = re.search(r' viewBox="[^"]*"', head)
    if width is None or box is None:
        raise ValueError(f"the drawing {name!r} must have a width and a viewBox, got {head!r}")
    style = f' style="max-width: {width[1]}px"'
    label = f' role="img" aria-label="{escape(description)}"'
    return Markup(in_page_colours(f"<svg{label}{box[0]}{style}>{rest}"))


def clean_figures(out: Path) -> Path:
    """Remove the figures and tables of an earlier report; returns the folder of the figures.

    A `ValueError` says that the folder of the report holds another page.
    """
    folder = out / FIGURES
    folder.mkdir(parents=True, exist_ok=True)
    own_files(out, ["report.html"], is_run=holds_run(out))
    remove_own_files(out, (FIGURES, TABLES))
    return folder


@cache
def _templates() -> Environment:
    templates = Environment(
        loader=FunctionLoader(_resource),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    templates.filters["paint"] = in_page_colours
    templates.filters["slug"] = lambda heading: "-".join(re.findall(r"\w+", heading.lower()))
    return templates


@cache
def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _vega() -> str:
    """Vega, Vega-Lite and Vega-Embed as one script; making it takes seconds: it is kept beside the compiled modules."""
    with suppress(OSError):
        return _KEPT_LIBRARY.read_text(encoding="utf-8")
    script = vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;").replace("</script", "<\\/script")
    script = f"(() => {{{script}}})();"  # its names stay its own
    with suppress(OSError):
        write_text(_KEPT_LIBRARY, script)
    return script


# ---- tables, and links to files -------------------------------------------------------------------------------------


def on_page(table: Table, out: Path | None = None) -> Markup:
    """Markup of a sortable table; one that names a file is written to `out`/tables as LaTeX, too, and linked below."""
    rows = [[replace(cell, key=_sorting_key(cell)) for cell in row] for row in table.cells]
    if out is None or not table.latex:
        return part("table", table.columns, rows, table.look)
    file = f"{TABLES}/{table.latex}.tex"
    own_files(out, [file])
    write_text(out / file, latex_table(table))
    return part("table", table.columns, rows, table.look, file)


def _sorting_key(cell: TableCell) -> str:
    return cell.text if cell.key == "" else "" if cell.key is None else str(cell.key)


_DATA_FILES = (".json", ".csv", ".parquet", ".toml", ".sqlite")
Recordings = Mapping[str, Mapping[str, Path]]
"""Files of the recordings: by the name of the seed's files, then by what they are called ("recording")."""


def data_section(out: Path, recordings: Recordings | None = None) -> Section:
    """Section of links to the files of a run directory, as far as they are there; empty where there are none."""
    names = sorted(file.name for file in out.glob("[!.]*") if file.suffix in _DATA_FILES)
    files_by_seed = _found(out, recordings or {})
    contents: list[Content] = []
    if names:
        contents.append(part("links", "Beside this page:", [(name, quote(name)) for name in names]))
    if files_by_seed:
        columns = list(dict.fromkeys(name for row in files_by_seed.values() for name in row))
        rows = [
            [
                TableCell(seed),
                *(
                    TableCell(row[name].suffix[1:], link=_address(row[name], out)) if name in row else ""
                    for name in columns
                ),
            ]
            for seed, row in files_by_seed.items()
        ]
        headings = [Column("Files", kind="text"), *(Column(name, kind="text") for name in columns)]
        guide = (
            "Recordings, and trajectories as TUM has them: t x y z qx qy qz qw. Beside each lie the same poses as"
            " .kitti and, with covariances, as .square."
        )
        block = Markup("\n").join([part("paragraph", guide), on_page(Table(headings, rows))])
        contents.append(Block("Recordings and trajectories", block, folded=True))
    return Section("Data", contents, kind="screen")


def _found(out: Path, recordings: Recordings) -> dict[str, dict[str, Path]]:
    """Files by seed, then by column: recordings, then trajectories, the truth first."""
    files_by_seed: dict[str, dict[str, Path]] = {}
    for seed, paths in recordings.items():
        if existing := {name: path for name, path in paths.items() if path.is_file()}:
            files_by_seed[seed] = existing
    for path in sorted(
        out.glob("trajectories/*/*.tum"), key=lambda path: (path.parent, path.stem != "truth", path.stem)
    ):
        files_by_seed.setdefault(path.parent.name, {})[path.stem] = path
    return files_by_seed


def _address(path: Path, out: Path) -> str:
    return quote(Path(os.path.relpath(path, out)).as_posix())
