"""The manual is built without a warning, and its pages need nothing but each other (about 15 s)."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ENVIRONMENTS = ("drive", "gaze", "drive_gaze", "active_gaze", "closed_loop", "branches", "follow")

pytest.importorskip("mkdocs", reason="needs the extra docs")
pytest.importorskip("material", reason="needs the extra docs")
pytest.importorskip("mkdocstrings", reason="needs the extra docs")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The manual as `make docs` builds it; dead links and pages out of the navigation fail."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stdout + done.stderr
    return folder


def pages(site):
    return sorted(site.rglob("*.html"))


def test_every_page_of_the_sources_is_there(site):
    wanted = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in DOCS.rglob("*.md")}
    wanted |= {f"environments/{name}.html" for name in ENVIRONMENTS}
    assert wanted <= {path.relative_to(site).as_posix() for path in pages(site)}


def test_no_page_takes_anything_from_elsewhere(site):
    taken = re.compile(r'<(?:script|img|link|iframe|source)\b[^>]*\b(?:src|href)="((?:https?:)?//[^"]*)"')
    outside = {(path.name, url) for path in pages(site) for url in taken.findall(path.read_text(encoding="utf-8"))}
    assert outside == set()


def test_the_pages_of_the_environments_have_their_tables(site):
    for name in ENVIRONMENTS:
        text = (site / "environments" / f"{name}.html").read_text(encoding="utf-8")
        for heading in ("Action Space", "Observation Space", "Rewards", "Arguments"):
            assert f">{heading}<" in text, (name, heading)
        assert text.count("<table>") >= (3 if name in ("drive", "gaze", "drive_gaze") else 1)


@pytest.mark.parametrize("package", ["filters", "stereo_slam_env", "stereo_slam_env.envs"])
def test_the_reference_has_every_public_name_with_what_it_says(site, package):
    text = (site / "api" / f"{package}.html").read_text(encoding="utf-8")
    module = importlib.import_module(package)
    listed = [name for name in module.__all__ if not name.startswith("_")]
    assert [name for name in listed if not re.search(rf'id="{package}\.[\w.]*\b{name}"', text)] == []
    plain = " ".join(re.sub(r"<[^>]*>", "", text).split())
    said = {name: re.match(r"[\w ,-]*", getattr(module, name).__doc__)[0].strip() for name in listed}
    assert [name for name, words in said.items() if words not in plain] == []


def test_links_to_code_lead_to_pages_with_that_code(site):
    text = (site / "write_a_filter.html").read_text(encoding="utf-8")
    assert 'href="code/examples/write_a_filter.py.html"' in text
    assert "StackedEKF" in (site / "code" / "examples" / "write_a_filter.py.html").read_text(encoding="utf-8")


def test_equations_are_typeset(site):
    derivations = sorted((site / "derivations").glob("*.html"))
    assert len(derivations) == len(list((DOCS / "derivations").glob("*.md"))) > 0
    for path in derivations:
        assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">' in path.read_text(encoding="utf-8")
    assert [path.name for path in pages(site) if 'class="arithmatex"' in path.read_text(encoding="utf-8")] == []


@pytest.mark.skipif(BROWSER is None, reason="needs the browser chromium (apt install chromium)")
def test_opened_from_a_file_it_asks_for_nothing_and_its_search_finds(site):
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright (extra dev)")
    requests, complaints = [], []
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        page.set_default_timeout(120_000)  # ms: on a busy machine a browser starts slowly
        page.on("request", lambda request: requests.append(request.url))
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto((site / "index.html").as_uri())
        page.wait_for_function("document.querySelector('iframe')?.contentDocument.scripts.length", timeout=60_000)
        page.click("input[name=query]")
        page.fill("input[name=query]", "anchor")  # at once: on a busy machine a part of a word is a query by itself
        page.keyboard.press("End")
        page.wait_for_selector(".md-search-result__link", state="attached", timeout=60_000)
        found = page.eval_on_selector_all(".md-search-result__link", "links => links.map(link => link.href)")
        page.goto((site / "derivations" / "inverse_depth.html").as_uri())
        chromium.close()
    assert complaints == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    assert any("inverse_depth" in link for link in found)
