"""The pages over many scenarios and of two runs (about 6 s)."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from markupsafe import Markup

from stereo_slam_env.benchmark.recordings.sources import StreetSource
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.benchmark.statistics.attribution import attribute_runs
from stereo_slam_env.benchmark.statistics.comparison import compare
from stereo_slam_env.report import page
from stereo_slam_env.report.benchmark_report import write_study_report
from stereo_slam_env.report.comparison_report import write_comparison_report

from ...synthetic_runs import THREE, Behaviour, make_bounds, make_runs, scored
from .test_run_report import Page

SCENARIO = Scenario("made-up", StreetSource({"route": "town"}), seeds=(0,))


@pytest.fixture
def drawn(monkeypatch):
    """Names of the figures of the page; drawing them is tested elsewhere."""
    names = []

    def figure_blocks(drawings, _):
        names.extend(drawing.name for drawing in drawings)
        return {drawing.name: Markup(f"<figure>{drawing.name}</figure>") for drawing in drawings}

    monkeypatch.setattr(page, "figure_blocks", figure_blocks)
    return names


def outcome(behaviours=THREE, seeds=range(6), frames=40):
    runs = make_runs(behaviours, seeds, frames)
    summaries, figures = scored(runs, bounds=make_bounds(runs))
    return SimpleNamespace(runs=runs, summaries=summaries, figures=figures)


def grid():
    results, cells = {}, []
    for sigma in (0.5, 2.0):
        for noise in ("pixels", "uvd"):
            name = f"sigma-{sigma}_noise-{noise}"
            cells.append(Cell(name, {"options.sigma": sigma, "noise": noise}, SCENARIO))
            results[name] = outcome([replace(b, error_m=sigma * b.error_m) for b in THREE])
    return Study("mismatch", tuple(cells)), results


def read(path):
    return Page(path.read_text(encoding="utf-8"))


def test_a_grid_shows_every_cell_and_factor_and_leads_to_the_reports_of_the_cells(tmp_path, drawn):
    study, results = grid()
    path = write_study_report(tmp_path, study, results)
    page = read(path)
    text = " ".join(page.text)
    assert path == tmp_path / "report.html"
    assert "Study: mismatch" in text
    assert "has the smallest position error in" in text
    assert "Effect of options.sigma" in text
    assert "Effect of noise" in text
    assert {f"cells/{cell.name}/report.html" for cell in study.cells} <= set(page.links)
    assert drawn == ["factor_0", "factor_1"]
    assert page.tags.count("tr") == 1 + 4 + 1 + 4 * 3


def test_a_real_study_has_a_row_for_each_filter_when_there_are_more_filters_than_data_sets(tmp_path, drawn):
    cells = tuple(Cell(name, {"cell": name}, SCENARIO) for name in ("kitti07_tracks", "starry_night_a"))
    results = {cell.name: outcome(seeds=[None]) for cell in cells}
    page = read(write_study_report(tmp_path, Study("real", cells), results))
    assert page.tags.count("tr") == 1 + 3 + 1 + 2 * 3
    assert "Side by side" in " ".join(page.text)
    assert drawn == ["factor_0"]


def test_the_level_of_a_factor_may_be_a_table(tmp_path, drawn):
    noises = ({"independent_pixels": 1.0}, {"independent_pixels": 2.0}, None)
    cells = tuple(Cell(f"cell-{i}", {"noise": noise}, SCENARIO) for i, noise in enumerate(noises))
    write_study_report(tmp_path, Study("noise", cells), {cell.name: outcome(seeds=[0]) for cell in cells})
    assert drawn == ["factor_0"]


def test_attribution_is_said_first_and_tabulated(tmp_path, drawn):
    factors = {"landmark": ("inverse-depth", "euclidean"), "error": ("so3", "quaternion")}
    filters = [
        Behaviour(f"{a}+{b}", 0.1 if a == "inverse-depth" else 0.9)
        for a in factors["landmark"]
        for b in ("so3", "quaternion")
    ]
    result = outcome(filters, range(8))
    study = Study("attribution", (Cell("attribution", {}, SCENARIO),), factors)
    attribution = attribute_runs(factors, result.figures)
    page = read(write_study_report(tmp_path, study, {"attribution": result}, attribution))
    text = " ".join(page.text)
    assert text.index("'euclidean' instead of 'inverse-depth'") < text.index("Which choice makes the difference?")
    assert "Share of the differences explained" in text
    assert "Interactions of two options" in text
    assert drawn == ["effects"]


def test_a_study_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nothing to report"):
        write_study_report(tmp_path, Study("empty", (Cell("a", {}, SCENARIO),)), {})


def test_what_changed_between_two_runs(tmp_path, drawn):
    before = outcome(THREE[:2], range(8))
    after = outcome([replace(THREE[0], milliseconds=1.0), THREE[1]], range(8))
    comparison = compare(before, after)
    path = write_comparison_report(tmp_path, comparison)
    page = read(path)
    text = " ".join(page.text)
    assert path == tmp_path / "comparison.html"
    assert "What changed" in text
    assert "time, ms" in text
    assert "better" in text
    assert drawn == ["changes"]
