"""What tests of pages share: a report of made-up runs, written once, and a browser."""

import pytest

from stereo_slam_env.report.run_report import write_report

from ...synthetic_runs import THREE_ONE_DIVERGING, Behaviour, make_bounds, make_runs, scored
from .browsing import BROWSER, PATIENCE

SETTINGS = {"scenario": "made up", "noise": {"independent_pixels": 1.0}, "gate": None, "seeds": [0, 1, 2, 3, 4, 5]}


@pytest.fixture(scope="session")
def five_filters():
    """Behaviours of the filters in the report: one diverges, one is clumsy."""
    return (*THREE_ONE_DIVERGING, Behaviour("shared-anchor", 0.11, 1.0, 2.2), Behaviour("clumsy", 0.4, 2.5, 9.0))


@pytest.fixture(scope="session")
def report_of_five(five_filters, tmp_path_factory):
    """The page of five filters on six recordings."""
    runs = make_runs(five_filters, range(6), frames=240)
    bounds = make_bounds(runs)
    summaries, figures = scored(runs, bounds=bounds)
    out = tmp_path_factory.mktemp("report")
    return write_report(out, "Wide turns", runs, summaries, figures, SETTINGS, bounds=bounds)


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium; without one the test is skipped."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright (extra dev)")
    if BROWSER is None:
        pytest.skip("needs the browser chromium (apt install chromium)")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"], timeout=PATIENCE
        )
        yield chromium
        chromium.close()
