"""The page stands alone, is well formed, and tells what the runs say (about 15 s)."""

import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from PIL import Image

from stereo_slam_env.benchmark.report import write_report
from stereo_slam_env.benchmark.summary import summarise_all

from ...synthetic_runs import THREE_ONE_DIVERGING, make_runs

SETTINGS = {"scenario": "made up", "noise": {"independent_pixels": 1.0}, "gate": None, "seeds": [0, 1, 2, 3, 4]}
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


def report(tmp_path, runs, title="Wide turns", settings=SETTINGS):
    return write_report(tmp_path / "out", title, runs, summarise_all(runs), settings)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return report(tmp_path_factory.mktemp("report"), make_runs(THREE_ONE_DIVERGING, frames=240))


@pytest.fixture(scope="module")
def page(path):
    return Page(path.read_text(encoding="utf-8"))


def test_the_page_is_well_formed_and_needs_nothing_but_itself(path, page):
    markup = path.read_text(encoding="utf-8")
    assert page.open == []
    assert all(link.startswith("#") for link in page.links)
    assert not re.search(r"https?:|@import|url\((?!#)", markup)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links} <= set(page.ids)
    assert not re.search(r"\$[a-z_]+", markup.split("<script>")[0])


def test_the_page_has_a_dark_and_a_printed_form(path):
    markup = path.read_text(encoding="utf-8")
    assert "prefers-color-scheme: dark" in markup
    assert "@media print" in markup


def test_the_first_screen_comes_first(page):
    text = " ".join(page.text)
    order = [
        "Wide turns",
        "smallest position error",
        "How accurate?",
        "How honest?",
        "How fast?",
        "Trajectory",
        "Settings",
    ]
    places = [text.index(words) for words in order]
    assert places == sorted(places)


def test_every_figure_is_in_the_page_and_in_a_file(path, page):
    files = sorted(file.stem for file in (path.parent / "figures").glob("*.png"))
    assert page.tags.count("figure") == page.tags.count("svg") == len(files)
    assert {"trajectory", "error_by_run", "nees", "nis", "depth", "velocity", "time_per_frame"} < set(files)
    assert len([name for name in files if name.startswith("error_") and name != "error_by_run"]) == 3
    for name in files:
        with Image.open(path.parent / "figures" / f"{name}.png") as image:
            assert image.width > 1200


def test_the_diverged_filter_is_marked(page):
    text = "".join(page.text)
    assert "diverged 5/5" in text
    assert "euclidean diverged in 5 of 5 runs" in text


def test_settings_are_all_there(page):
    text = "".join(page.text)
    for words in ("made up", "independent_pixels", "0, 1, 2, 3, 4", "none"):
        assert words in text


def test_names_are_escaped(tmp_path):
    runs = [replace(run, filter_name="<b>&", traces=()) for run in make_runs(seeds=[0], frames=30)[:1]]
    path = report(tmp_path, runs, title="a < b", settings={"<k>": "<v>"})
    markup = path.read_text(encoding="utf-8")
    assert Page(markup).open == []
    assert "<b>&" not in markup
    assert "<v>" not in markup
    assert "a &lt; b" in markup


def test_real_data_without_truth(tmp_path):
    path = report(tmp_path, make_runs(seeds=[None], frames=60, truth="none"))
    text = "".join(Page(path.read_text(encoding="utf-8")).text)
    assert "no ground truth" in text
    assert "Run by run" not in text
    assert not (path.parent / "figures" / "nees.png").exists()


def test_real_data_with_gaps_in_the_truth(tmp_path):
    path = report(tmp_path, make_runs(seeds=[None], frames=60, truth="gaps"))
    assert "one run shows no general difference" in path.read_text(encoding="utf-8")


def test_failures_are_listed_and_nothing_is_left_from_an_earlier_report(tmp_path):
    stale = tmp_path / "out" / "figures" / "depth.png"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"of another run")
    runs = make_runs(seeds=[0], frames=30)
    path = report(tmp_path, [replace(run, failure="frame 3: ValueError: no", traces=()) for run in runs])
    assert "seed 0, frame 3: ValueError: no" in path.read_text(encoding="utf-8")
    assert not stale.exists()


def test_nothing_to_report_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nothing to report"):
        write_report(tmp_path, "empty", [], [], {})


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs the browser chromium (apt install chromium)")
@pytest.mark.parametrize("width", [500, 1280])
def test_the_page_does_not_scroll_sideways_and_its_table_sorts(path, tmp_path, width):
    probe = """<script>addEventListener("load", () => {
        document.querySelectorAll("table.results button")[1].click();
        const names = [...document.querySelectorAll(".results tbody tr")].map(row => row.cells[0].dataset.value);
        const wide = document.documentElement.scrollWidth > innerWidth;
        document.title = `wide=${wide} order=${names.join()}`;
    })</script>"""
    copy = tmp_path / "probe.html"
    copy.write_text(path.read_text(encoding="utf-8").replace("</body>", probe + "</body>"), encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    command = ["chromium", *flags.split(), "--disable-component-update", "--disable-sync"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},900", "--dump-dom", copy.as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    title = re.search(r"<title>(.*?)</title>", dom)[1]
    assert title.startswith("wide=false")
    assert title.endswith("euclidean")
