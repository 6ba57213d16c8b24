"""Names from strangers are words in every page, never markup: by the text of the pages, and in a browser (20 s)."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import product
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from stereo_slam_env.benchmark import compare
from stereo_slam_env.benchmark.recordings.sources import StreetSource
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import Cell, Study, factorial_label
from stereo_slam_env.benchmark.statistics.attribution import attribute_runs
from stereo_slam_env.benchmark.statistics.policy_verdict import Looks
from stereo_slam_env.report.benchmark_report import write_study_report
from stereo_slam_env.report.comparison_report import write_comparison_report
from stereo_slam_env.report.page import _vega, html_page
from stereo_slam_env.report.run_report import write_report

from ...synthetic_runs import Behaviour, make_runs, scored
from ..benchmark.small_recordings import small_recording
from .browsing import Visit

pytestmark = pytest.mark.slow

SCENARIO = Scenario("made-up", StreetSource({"route": "town"}), seeds=(0,))

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
    "<a href='javascript:alert(8)'>x</a>",
    '<a href="https://stranger.invalid/">x</a>',
)


def result(runs):
    """What a report asks of a cell."""
    summaries, figures = scored(runs)
    return SimpleNamespace(runs=runs, summaries=summaries, figures=figures)


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
    text = path.read_text(encoding="utf-8").replace(_vega(), "")
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


def write_hostile_report(out, runs):
    (out / "<img src=x onerror=alert(7)>.json").write_text("{}")
    settings = {name: {"name": name, "list": [name], "tables": [{name: name}]} for name in EVIL}
    return write_report(out, EVIL[0] + EVIL[7], runs, *scored(runs), settings)


def write_hostile_policies(out, runs):
    names = list(dict.fromkeys(run.filter_name for run in runs))
    looks = Looks(names[0], {name: small_recording(frames=4) for name in names})
    return write_report(out, EVIL[1], runs, *scored(runs), {}, looks=looks)


def write_hostile_comparison(out, runs):
    changed = [replace(run, positions=run.positions + 0.3) for run in runs]
    return write_comparison_report(out, compare(result(runs), result(changed)))


def write_hostile_study(out, runs):
    levels = dict(zip(("a", "b"), EVIL[:2], strict=True))
    cells = tuple(Cell(name, {EVIL[2]: level}, SCENARIO) for name, level in levels.items())
    results = dict.fromkeys(levels, result(runs))
    return write_study_report(out, Study(EVIL[0] + EVIL[4], cells), results)


def write_hostile_attribution(out, _):
    factors = {EVIL[0]: (EVIL[1], EVIL[2]), EVIL[8]: (EVIL[9], EVIL[10])}
    labels = [factorial_label(dict(zip(factors, levels, strict=True))) for levels in product(*factors.values())]
    runs = make_runs([Behaviour(label, 0.1 * (1 + n)) for n, label in enumerate(labels)], range(4), frames=40)
    outcome = result(runs)
    study = Study(EVIL[3], (Cell("a", {}, SCENARIO),), factors)
    return write_study_report(out, study, {"a": outcome}, attribute_runs(factors, outcome.figures))


WRITERS = {
    "report": write_hostile_report,
    "policies": write_hostile_policies,
    "comparison": write_hostile_comparison,
    "study": write_hostile_study,
    "attribution": write_hostile_attribution,
}


@pytest.fixture(scope="module", params=WRITERS)
def path(request, tmp_path_factory):
    """Each page that results are written on."""
    return WRITERS[request.param](tmp_path_factory.mktemp(request.param), hostile_runs())


def test_it_holds_their_words_and_no_markup_of_theirs(path):
    text = require_harmless(path, own_scripts=2 if 'class="chart-data"' in path.read_text(encoding="utf-8") else 1)
    assert "alert(" in text
    for drawing in (path.parent / "figures").glob("*.svg"):
        for element in ElementTree.parse(drawing).iter():
            assert element.tag.rpartition("}")[2] not in ("script", "img", "foreignObject", "a")
            assert not any(name.startswith("on") for name in element.attrib)


def test_in_a_browser_nothing_of_theirs_runs_and_nothing_is_fetched(path, browser):
    visit = Visit(browser, path)
    visit.see_everything()
    assert visit.complaints == []
    assert visit.dialogs == []
    assert visit.requests == [path.as_uri()]
    assert visit.page.url == path.as_uri()
    links = "[...document.querySelectorAll('a')].map(a => a.getAttribute('href') ?? a.getAttribute('xlink:href') ?? '')"
    assert not [link for link in visit.value(links) if re.match(r"\s*(javascript|data)|.*stranger", link)]
    visit.page.close()


def test_words_of_the_template_of_the_page_stay_words():
    assert html_page(title="{{ body }}", subtitle="", body="{% raw %}").count("{{ body }}") == 2


@pytest.mark.parametrize("evil", EVIL[:3])
def test_the_browser_would_see_it_run(evil, browser, tmp_path):
    (tmp_path / "page.html").write_text(f"<p title='a'>{evil.replace('src=x', 'src=nothing.png')}</p>")
    visit = Visit(browser, tmp_path / "page.html")
    visit.page.wait_for_timeout(500)
    assert len(visit.dialogs) == 1
    visit.page.close()


def test_the_check_sees(tmp_path):
    for evil in EVIL[:3]:
        (tmp_path / "page.html").write_text(f"<p title='a'>{evil}</p>")
        with pytest.raises(AssertionError):
            require_harmless(tmp_path / "page.html", own_scripts=0)
