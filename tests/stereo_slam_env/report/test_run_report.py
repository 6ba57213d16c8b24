"""The page stands alone, is well formed, and tells what the runs say (about 10 s)."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from types import MappingProxyType

import numpy as np
import pytest
from markupsafe import Markup
from PIL import Image

from stereo_slam_env.benchmark.statistics.verdict import judge
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.files import own_files
from stereo_slam_env.recording.recording import Reference
from stereo_slam_env.report.overview import overview
from stereo_slam_env.report.page import _vega
from stereo_slam_env.report.run_report import write_report

from ...synthetic_runs import THREE, Behaviour, make_bounds, make_runs, scored

VOID = {"meta", "link", "br", "img", "input"}


class Page(HTMLParser):
    """Checks that tags close in order, and collects text, ids and everything that points somewhere."""

    def __init__(self, markup):
        super().__init__()
        self.open, self.ids, self.links, self.text, self.tags = [], [], [], [], []
        self.feed(markup)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.ids += [value for name, value in attrs if name == "id"]
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def without_library(path):
    """The text of a page but for the script that draws its charts."""
    return path.read_text(encoding="utf-8").replace(_vega(), "")


def report(tmp_path, runs, title="Wide turns", settings=MappingProxyType({})):
    bounds = make_bounds(runs) if any(run.seed is not None for run in runs) else {}
    summaries, figures = scored(runs, bounds=bounds)
    return write_report(tmp_path / "out", title, runs, summaries, figures, settings, bounds=bounds)


@pytest.fixture(scope="module")
def path(report_of_five):
    return report_of_five


@pytest.fixture(scope="module")
def markup(path):
    """The page without the library for its charts."""
    return without_library(path)


@pytest.fixture(scope="module")
def page(markup):
    return Page(markup)


@pytest.fixture
def no_figures(monkeypatch):
    """What the page says does not depend on its figures, and they take time."""
    blocks = lambda drawings, _: {one.name: Markup(f"<figure>{one.name}</figure>") for one in drawings}  # noqa: E731
    monkeypatch.setattr("stereo_slam_env.report.page.figure_blocks", blocks)


def test_the_page_is_well_formed_and_needs_nothing_but_itself(path, markup, page):
    assert page.open == []
    assert all(link.startswith(("#", "figures/", "tables/")) for link in page.links)
    assert all((path.parent / link).is_file() for link in page.links if not link.startswith("#"))
    assert not re.search(r"https?:(?!//vega.github.io/schema/)|@import|url\((?!#)", markup)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert "{{" not in markup.split("<script>")[0]
    assert "{%" not in markup


def test_the_page_has_a_dark_and_a_printed_form(markup):
    assert "prefers-color-scheme: dark" in markup
    assert "@media print" in markup


def test_the_first_screen_comes_first_and_asks_all_the_questions(page):
    text = " ".join(page.text)
    assert text.index("Wide turns") < text.index("Reference: ")
    text = text[text.index("Reference: ") :]  # behind the contents
    order = [
        "smallest position error",
        "Which is best?",
        "By how much, is it sure?",
        "Is it consistent?",
        "How far from the limit?",
        "What does it cost?",
        "Accuracy",
        "Distance from the limit",
        "Consistency",
        "Each against each",
        "Settings",
    ]
    places = [text.index(words) for words in order]
    assert places == sorted(places)


def test_every_figure_is_in_the_page_and_in_files(path, page):
    files = {file.stem for file in (path.parent / "figures").glob("*.png")}
    assert files == {file.stem for file in (path.parent / "figures").glob("*.svg")}
    assert page.tags.count("figure") == len(files)
    accuracy = {"error_by_run", "trajectory", "relative_error", "error_and_limit", "efficiency", "velocity"}
    honesty = {"consistency", "nees", "nis", *(f"error_{i}" for i in range(5))}
    assert files == accuracy | honesty | {"landmarks", "convergence", "depth", "cost", "time_per_frame"}
    for name in files:
        with Image.open(path.parent / "figures" / f"{name}.png") as image:
            assert image.width > 1200


def test_every_figure_is_interactive(page, markup):
    assert markup.count('class="chart-data"') == page.tags.count("figure")


def test_the_diverged_filter_is_marked(page):
    text = "".join(page.text)
    assert "diverged 6/6" in text
    assert "euclidean diverged in 6 of 6 runs" in text


@pytest.mark.usefixtures("no_figures")
def test_a_reference_that_is_no_truth_stands_out_and_no_nees_is_held_against_it(tmp_path):
    """With the NEES that a run does not have then (see the runner), and an NIS of 0.04."""
    from_images = Reference("odometry", "Made of <these> pixels.")
    unknown = np.full(60, np.nan)
    runs = [
        replace(
            run,
            truth_from=from_images,
            **dict.fromkeys(("pose_nees", "position_nees", "rotation_nees", "landmark_nees"), unknown),
            landmark_statistics=LandmarkStatistics(),
            nis=0.04 * run.nis_dof,
        )
        for run in make_runs(seeds=[None], frames=60)
    ]
    markup = without_library(report(tmp_path, runs))
    reference, innovations = re.findall('<p class="banner">(.*?)</p>', markup)
    assert reference.startswith("Reference: odometry from the same images. Made of &lt;these&gt; pixels. ")
    assert markup.index(reference) < markup.index('class="headline"')
    assert "5.0 times smaller than claimed" in innovations
    assert "innovations 5.0 times smaller than claimed" in markup  # in the table of answers, too
    for claim in ("it is consistent", "its band", "pose NEES", "3σ bounds", "<figure>nees", "<figure>error_0"):
        assert claim not in markup


def test_an_independent_truth_is_named_quietly(markup):
    assert '<p class="quiet">Reference: independent truth (simulation). ' in markup
    assert '<p class="banner">Reference' not in markup


def test_no_ranking_without_what_the_runs_show():
    runs = make_runs(THREE[:2], range(6), frames=40)
    summaries, figures = scored(runs)
    said = "".join(Page(overview(summaries, judge(summaries, figures))).text)
    assert "not significant" in said
    assert "worse" not in said
    assert re.search(r"[−+]\d+ to \+\d+ %", said)


def test_a_worse_filter_is_called_worse_with_its_interval():
    runs = make_runs((THREE[0], Behaviour("clumsy", 2.0)), range(10), frames=40)
    summaries, figures = scored(runs)
    said = "".join(Page(overview(summaries, judge(summaries, figures))).text)
    assert re.search(r"worse, \+[\d,]+ to \+[\d,]+ %", said)
    assert "best" in said


def test_of_many_filters_the_headline_counts():
    runs = make_runs([Behaviour(f"filter-{i}", 0.1) for i in range(8)], range(10), frames=30)
    summaries, figures = scored(runs)
    said = "".join(Page(overview(summaries, judge(summaries, figures))).text)
    assert "and 4 more are not significant" in said


def test_settings_are_all_there(page):
    text = "".join(page.text)
    for words in ("made up", "independent_pixels", "0, 1, 2, 3, 4, 5", "none"):
        assert words in text


@pytest.mark.usefixtures("no_figures")
def test_names_are_escaped(tmp_path):
    run = make_runs(seeds=[0], frames=30)[0]
    named = {"filter_name": "<b>&", "recording_name": "<s>street", "failure": "frame 3: </script><u>"}
    path = report(tmp_path, [run, replace(run, **named, traces=())], title="a < b", settings={"<k>": "<v>"})
    markup = without_library(path)
    assert Page(markup).open == []
    for evil in ("<b>&", "<v>", "<s>street", "<u>"):
        assert evil not in markup
    assert "a &lt; b" in markup


@pytest.mark.usefixtures("no_figures")
def test_real_data_without_truth(tmp_path):
    path = report(tmp_path, make_runs(seeds=[None], frames=60, truth="none"))
    text = "".join(Page(path.read_text(encoding="utf-8")).text)
    assert "no ground truth" in text
    assert "NIS / dof, 1 is ideal" in text
    for figure in ("error_by_run", "nees", "error_0", "efficiency"):
        assert figure not in text


@pytest.mark.usefixtures("no_figures")
def test_real_data_with_gaps_in_the_truth(tmp_path):
    path = report(tmp_path, make_runs(seeds=[None], frames=60, truth="gaps"))
    assert "one drive proves nothing" in path.read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_figures")
def test_options_that_a_filter_does_not_get_are_listed(tmp_path):
    runs = make_runs((Behaviour("mine", 0.1), Behaviour("theirs", 0.2)), seeds=[0])
    runs = [replace(run, not_given={"motion": "it has its own, <Mine>"}) for run in runs[:1]] + list(runs[1:])
    page = Page(report(tmp_path, runs).read_text(encoding="utf-8"))
    assert "mine does not get the common motion: it has its own, <Mine>." in page.text
    assert not any("theirs does not get" in text for text in page.text)


def test_failures_are_listed_and_nothing_is_left_from_an_earlier_report(tmp_path):
    stale = tmp_path / "out" / "figures" / "depth.png"
    stale.parent.mkdir(parents=True)
    own_files(tmp_path / "out", ["figures/depth.png"])
    stale.write_bytes(b"of another run")
    foreign = stale.with_name("thesis.png")
    foreign.write_bytes(b"of somebody else")
    runs = make_runs(seeds=[0], frames=30)
    path = report(tmp_path, [replace(run, failure="frame 3: ValueError: no", traces=()) for run in runs])
    assert "seed 0, frame 3: ValueError: no" in path.read_text(encoding="utf-8")
    assert not stale.exists()
    assert foreign.read_bytes() == b"of somebody else"


@pytest.mark.usefixtures("no_figures")
def test_tables_beside_the_page_are_linked(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "summary.json").write_text("{}")
    page = Page(report(tmp_path, make_runs(THREE[:1], [0], frames=30)).read_text(encoding="utf-8"))
    assert "summary.json" in page.links


def test_nothing_to_report_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nothing to report"):
        write_report(tmp_path, "empty", [], [], {}, {})


def test_where_the_images_contradict_a_reference_is_said_and_drawn_frame_by_frame(tmp_path):
    runs = make_runs(THREE, seeds=(None,))
    frames = np.arange(1.0, 9.0)
    audit = ReferenceAudit(frames, np.where(frames == 5.0, 3.0, 0.3), np.full(8, 0.2))
    page = write_report(tmp_path / "out", "Drive", runs, *scored(runs), {}, audits={runs[0].recording_name: audit})
    text = " ".join(Page(without_library(page)).text)
    assert "Is the reference right?" in text
    assert "disagree in 1 of 8 steps" in text
    assert "to frames 5 " in text
    assert "reference doubtful here" in (tmp_path / "out" / "figures" / "audit_0.svg").read_text()
    assert "Is the reference right?" not in without_library(report(tmp_path, runs))
