"""The page that reports are written on: self-contained, light and dark, printable, with live tables and charts.

Many charts are drawn in processes: the drawing of Vega has one thread in each.

The processes start from nothing; this one, which may have threads, is not forked.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
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
from stereo_slam_env.report.table import Column, Table, TableCell, latex_table

Picture = tuple[Chart, tuple[Path, ...]]
"""A chart, and the files that it is drawn into."""
FEWEST = 4
"""Charts for which another process is worth its start."""
MOST_PROCESSES = 4
SECONDS = 300.0
"""After so long a process that draws is given up."""


def save_all(pictures: Sequence[Picture]) -> list[str]:
    """Draw every chart into its files; returns the drawings, as `Chart.save` does.

    Those of a process that fails are drawn here, so that what is wrong with a chart is told as ever.
    """
    count = max(1, min(_cores(), MOST_PROCESSES, len(pictures) // FEWEST))
    shares = [range(first, len(pictures), count) for first in range(count)]
    drawings: dict[int, str] = {}
    with ExitStack() as stack:
        others_drawn = [stack.enter_context(_elsewhere([pictures[i] for i in share])) for share in shares[1:]]
        drawings |= {i: _saved(pictures[i]) for i in shares[0]}
        for share, drawn in zip(shares[1:], others_drawn, strict=True):
            found = drawn() or [_saved(pictures[i]) for i in share]
            drawings |= dict(zip(share, found, strict=True))
    return [drawings[i] for i in range(len(pictures))]


def _saved(picture: Picture) -> str:
    chart, paths = picture
    return chart.save(*paths)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _elsewhere(share: Sequence[Picture]) -> Iterator[Callable[[], list[str] | None]]:
    """A function that waits for the drawings of a process, None where it fails; it ends with the block."""
    specs = [[chart.spec, [str(path.resolve()) for path in paths]] for chart, paths in share]
    code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import draw_share; draw_share()"
    with tempfile.TemporaryFile() as request, tempfile.TemporaryFile() as drawn:
        request.write(json.dumps(specs).encode())
        request.seek(0)
        process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=request, stdout=drawn, stderr=subprocess.DEVNULL, start_new_session=True
        )

        def wait() -> list[str] | None:
            try:
                if process.wait(SECONDS) != 0:
                    return None
            except subprocess.TimeoutExpired:
                return None
            drawn.seek(0)
            drawings: list[str] = json.loads(drawn.read())
            return drawings

        try:
            yield wait
        finally:
            process.kill()
            process.wait()


def draw_share() -> None:
    """Draw what the standard input says, and write the drawings as JSON."""
    pictures = json.loads(sys.stdin.read())
    json.dump([Chart(spec).save(*map(Path, paths)) for spec, paths in pictures], sys.stdout)


FIGURES, TABLES = "figures", "tables"
"""Folders of the figures, and of the tables as LaTeX, beside the page."""
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


def write_page(path: Path, *, title: str, subtitle: str, parts: Sequence[Markup]) -> Path:
    """Write a page, whole or not at all, with these parts one below the other, in a folder that is made.

    Returns its path; a `ValueError` says that another page is there.
    """
    own_files(path.parent, [path.name])
    page = html_page(title=title, subtitle=subtitle, body=Markup("\n").join(parts))
    write_text(path, page)
    return path


def part(name: str, /, *arguments: Any, **named: Any) -> Markup:
    """A part of a page, a macro of `parts.html`; plain text is escaped there, `Markup` is not."""
    macro = getattr(_templates().get_template("parts.html").module, name)
    return Markup(macro(*arguments, **named).strip())


def figure_block(chart: Chart, name: str, description: str, folder: Path) -> Markup:
    """Save a chart as PNG and SVG, and return it as markup for a page; arguments as of `figure_blocks`."""
    return figure_blocks({name: (chart, description)}, folder)[name]


def figure_blocks(charts: Mapping[str, tuple[Chart, str]], folder: Path) -> dict[str, Markup]:
    """Save charts as PNG and SVG, and return them as markup for a page.

    Parameters
    ----------
    charts : mapping of str to (Chart, str)
        By the name of the files, and of the figure in the page: letters, digits, "_" and "-", unique in the page. The
        chart, drawn with the colours of `axes`, and one sentence of plain text: the caption, and what a screen reader
        says.
    folder : Path
        Where `<name>.png` and `<name>.svg` go, beside the page: links in the page are relative to its parent.

    Returns
    -------
    dict of str to Markup
        By name, a `<figure>` with the drawing inline, and the chart that takes its place where there is JavaScript.
    """
    folder.mkdir(parents=True, exist_ok=True)
    own_files(folder.parent, [f"{folder.name}/{name}{ending}" for name in charts for ending in (".png", ".svg")])
    pictures = [(chart, (folder / f"{name}.png", folder / f"{name}.svg")) for name, (chart, _) in charts.items()]
    blocks = {}
    for (name, (chart, description)), svg in zip(charts.items(), save_all(pictures), strict=True):
        # Inside a script element "<" could end it.
        data = json.dumps(chart.spec, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        blocks[name] = part(
            "figure",
            name=name,
            place=f"{folder.name}/{name}",
            description=description,
            drawing=inline_svg(svg, name, description),
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
    """The folder of the figures, without those of an earlier report, nor its tables.

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


def on_page(table: Table, latex: Path | None = None) -> Markup:
    """Markup of a sortable table.

    Parameters
    ----------
    table : Table
        Headings and rows.
    latex : Path, optional
        File, in a folder beside the page, that the table is written to as LaTeX, too, and that is linked below it.
    """
    rows = [[replace(cell, key=_sorting_key(cell)) for cell in row] for row in table.cells]
    if latex is None:
        return part("table", table.columns, rows, table.look)
    file = f"{latex.parent.name}/{latex.name}"
    own_files(latex.parent.parent, [file])
    write_text(latex, latex_table(table))
    return part("table", table.columns, rows, table.look, file)


def _sorting_key(cell: TableCell) -> str:
    return cell.text if cell.key == "" else "" if cell.key is None else str(cell.key)


_DATA_FILES = (".json", ".csv", ".parquet", ".toml", ".sqlite")
Recordings = Mapping[str, Mapping[str, Path]]
"""Files of the recordings: by the name of the seed's files, then by what they are called ("recording")."""


def data_section(out: Path, recordings: Recordings | None = None) -> Markup:
    """Section of links to the files of a run directory, as far as they are there; empty where there are none."""
    names = sorted(file.name for file in out.glob("[!.]*") if file.suffix in _DATA_FILES)
    files_by_seed = _found(out, recordings or {})
    if not names and not files_by_seed:
        return Markup()
    contents = [part("links", "Beside this page:", [(name, quote(name)) for name in names])] if names else []
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
        contents.append(part("folded", "Recordings and trajectories", block))
    return part("section", "Data", "", contents, "screen")


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
