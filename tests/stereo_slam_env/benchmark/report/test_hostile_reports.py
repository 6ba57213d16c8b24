"""Names from strangers are words in every page, never markup: tables, drawings, charts, comparisons (10 s)."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from stereo_slam_env.benchmark import compare
from stereo_slam_env.benchmark.metrics.summary import summarise_all
from stereo_slam_env.benchmark.report.comparison_report import write_comparison_report
from stereo_slam_env.benchmark.report.run_report import write_report
from stereo_slam_env.viewer.page import _plotly_library

from ....synthetic_runs import make_runs

EVIL = (
    "<script>alert(1)</script>",
    "</script><script>alert(2)</script>",
    '"><img src=x onerror=alert(3)>',
    "' onmouseover='alert(4)",
    "<!--<script>",
    "]]><svg onload=alert(5)>",
    r"$\evil{x}$ and $2^",
    "$title ${body}",
    "javascript:alert(6)",
)


class Markup(HTMLParser):
    """What a browser would make of a page: elements with their attributes, and the scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data):
        if self.elements and self.elements[-1][0] == "script" and self.cdata_elem == "script":
            self.scripts[-1] += data


def require_harmless(path, own_scripts: int) -> str:
    text = path.read_text(encoding="utf-8").replace(_plotly_library() or "-", "")
    markup = Markup(text)
    for tag, attributes in markup.elements:
        assert tag not in ("img", "iframe", "object", "embed", "base", "form", "link"), tag
        assert not any(name.startswith("on") for name in attributes), attributes
        for name in ("href", "src", "xlink:href"):
            assert not re.match(r"\s*(javascript|data|https?|//)", attributes.get(name) or ""), attributes
    charts = [attributes for tag, attributes in markup.elements if tag == "script" and attributes]
    assert all(attributes == {"type": "application/json", "class": "chart-data"} for attributes in charts)
    assert len(markup.scripts) - len(charts) == own_scripts
    for script, (_, attributes) in zip(
        markup.scripts, [found for found in markup.elements if found[0] == "script"], strict=True
    ):
        if attributes:
            assert "<" not in script
            json.loads(re.sub(r"var\(--[\w-]+\)", "x", script))
        else:
            assert "alert" not in script
    return text


def hostile_runs():
    """Every text of a run is a stranger's."""
    runs = make_runs(seeds=[0, 1], frames=40)
    names = {run.filter_name: evil for run, evil in zip(runs, EVIL, strict=False)}
    return [
        replace(
            run,
            filter_name=names[run.filter_name],
            recording_name=EVIL[2] + EVIL[6],
            options={EVIL[0]: EVIL[1]},
            traces=tuple(replace(trace, label=EVIL[1]) for trace in run.traces),
            failure=EVIL[3] if run.seed else None,
        )
        for run in runs
    ]


@pytest.fixture(scope="module")
def runs():
    return hostile_runs()


def test_a_report_of_hostile_names(runs, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "<img src=x onerror=alert(7)>.json").write_text("{}")
    settings = {name: {"name": name, "list": [name], "tables": [{name: name}]} for name in EVIL}
    path = write_report(out, EVIL[0] + EVIL[7], runs, summarise_all(runs), settings)
    text = require_harmless(path, own_scripts=2 if _plotly_library() else 1)
    assert "$title ${body}" in text
    assert "&lt;script&gt;alert(1)" in text
    for drawing in (out / "figures").glob("*.svg"):
        for element in ElementTree.parse(drawing).iter():
            assert element.tag.rpartition("}")[2] not in ("script", "img", "foreignObject", "a")
            assert not any(name.startswith("on") for name in element.attrib)
        # Numbers on axes are words, too: nothing of Matplotlib's own mathematics is left over.
        assert "mathdefault" not in drawing.read_text(encoding="utf-8")


def test_a_comparison_of_hostile_names(runs, tmp_path):
    class Side:
        def __init__(self, given):
            self.runs = given

    changed = [replace(run, positions=run.positions + 0.3) for run in runs]
    path = write_comparison_report(tmp_path, compare(Side(runs), Side(changed)))
    require_harmless(path, own_scripts=2 if 'class="chart-data"' in path.read_text("utf-8") else 1)


def test_the_check_sees(tmp_path):
    for evil in EVIL[:3]:
        (tmp_path / "page.html").write_text(f"<p title='a'>{evil}</p>")
        with pytest.raises(AssertionError):
            require_harmless(tmp_path / "page.html", own_scripts=0)
