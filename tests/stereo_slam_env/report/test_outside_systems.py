"""What a report says of systems from outside: repeated runs as one system, and what is not known of them (5 s)."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from markupsafe import Markup

import stereo_slam_env as sse
from stereo_slam_env.evaluation.outside_run import outside_run
from stereo_slam_env.evaluation.trial import estimate_of
from stereo_slam_env.report.run_report import write_report

from ...synthetic_runs import Behaviour, make_runs, scored
from .test_run_report import without_library

REPEATED = "Systems, over runs and recordings"
OURS = Behaviour("inverse-depth", 0.10)
RUNS = [Behaviour(f"orbslam3+{k}", 0.30) for k in (1, 2, 3)]


def sections(path):
    """Markup of each section of a page, by its heading."""
    parts = re.split("<h2>(.*?)</h2>", without_library(path))[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def words(markup):
    """What a reader sees of it."""
    return " ".join(unescape(re.sub("<[^>]*>", " ", markup)).split())


def rows(section):
    """Words of the cells of the first table of a section, row by row."""
    table = section[section.index("<table") : section.index("</table>")]
    return [[words(cell) for cell in re.findall("<t[dh].*?</t[dh]>", row, re.DOTALL)] for row in table.split("<tr")[1:]]


def report(out, runs):
    summaries, figures = scored(runs)
    return write_report(out, "Outside", runs, summaries, figures, {})


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    monkeypatch.setattr(
        "stereo_slam_env.report.page.figure_blocks", lambda drawings, _: {one.name: Markup() for one in drawings}
    )


def test_runs_of_one_system_stand_as_one_row_with_their_scatter(tmp_path):
    runs = make_runs((OURS, *RUNS), seeds=range(8), frames=60)
    path = report(tmp_path, runs)

    _, figures = scored(runs)
    errors = np.array([[row["position_rmse_m"] for row in figures[b.name].of_run.values()] for b in (OURS, *RUNS)])
    logs = np.log(errors)
    scatter = 100 * np.sqrt(logs[1:].var(axis=0, ddof=1).mean())
    section = sections(path)[REPEATED]
    told = f"orbslam3: 3 runs of each recording, whose position errors scatter by {scatter:.2g} % (standard deviation)"
    assert told in words(section)
    ((ours, theirs, position, *_),) = rows(section)[1:]
    assert {ours, theirs} == {"inverse-depth", "orbslam3"}
    percent = 100 * np.expm1((logs[0] - logs[1:].mean(axis=0)).mean())
    assert position.startswith(f"{percent:+.0f}".replace("-", "−"))
    assert (tmp_path / "tables" / "systems.tex").is_file()


def test_where_nothing_is_run_twice_there_is_no_such_section(tmp_path):
    path = report(tmp_path, make_runs((OURS, Behaviour("orbslam3", 0.3)), seeds=range(2), frames=60))
    assert REPEATED not in sections(path)
    assert not (tmp_path / "tables" / "systems.tex").exists()


@pytest.fixture(scope="module")
def both():
    """A filter's run, and the trajectory that it would have written without covariances, as runs."""
    recording = sse.make_recording("reference-turn", 0)
    run = sse.evaluate("frame-to-frame", recording).series
    theirs = outside_run(recording, replace(estimate_of(run), covariances=None), label="theirs", seed=run.seed)
    return [run, theirs]


def test_what_a_trajectory_cannot_tell_is_a_dash_and_its_error_is_that_of_the_filter(both, tmp_path):
    page = sections(report(tmp_path, both))
    for section, column, known in (
        ("Accuracy", "Position error", True),
        ("Consistency", "Pose NEES", False),
        ("Cost and events", "Time", False),
    ):
        heading, ours, theirs = rows(page[section])
        at = next(k for k, title in enumerate(heading) if title.startswith(column))
        assert ours[at] != "–"
        assert theirs[at] == (ours[at] if known else "–")


def test_a_trajectory_is_not_counted_as_a_filter_on_the_same_measurements(both, tmp_path):
    told = words(without_library(report(tmp_path, both)))
    assert "1 filter · 1 trajectory from outside · 1 recording" in told
    assert "identical measurements" not in told
