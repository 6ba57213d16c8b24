"""Moving bodies in the report: ellipses, arrows, their NEES, and the sentence on them (5 s)."""

from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup

from stereo_slam_env.evaluation.results import BodyScores
from stereo_slam_env.report.charts.bodies import plot_body_map, plot_body_nees
from stereo_slam_env.report.charts.series import map_axes
from stereo_slam_env.report.run_report import write_report

from ....synthetic_runs import make_runs, scored
from .reading import panels

FRAMES, P = 30, np.diag([0.04, 1.0, 0.25])


def with_bodies(run, nees=(3.0, 60.0), swapped=False):
    """Two bodies beside the path, one of which may change to another true one half-way."""
    frames, numbers = np.repeat(np.arange(5, FRAMES), 2), np.tile([0, 1], FRAMES - 5)
    ages = 0.1 * (frames - 5)
    places = run.true_positions[frames] + np.where(numbers == 0, 4.0, -4.0)[:, None] * [1.0, 0.0, 0.0]
    values = np.where(ages < 1.0 - 1e-6, np.nan, np.array(nees)[numbers])
    true = np.where(swapped & (numbers == 1) & (frames > 20), 7, numbers)
    rows = (frames, numbers, numbers, true, ages, values, values, 0.0 * values, places, places + 0.1)
    claims = np.tile(P, (len(frames), 1, 1)), np.tile([0.0, 0.0, 2.0], (len(frames), 1))
    return replace(run, bodies=BodyScores(*rows, *claims, np.array([0.5, 0.7])))


@pytest.fixture(scope="module")
def runs():
    return make_runs(seeds=[0], frames=FRAMES)


def test_ellipses_and_arrows_are_what_is_claimed(runs):
    run = with_bodies(runs[0])
    (panel,) = panels(plot_body_map(run, run.bodies))
    lines = [row for row in panel.rows("lines") if row["said"] and "body 1, 0.5 s" in row["said"]]
    ellipse, arrow = (np.array([row["x"], row["y"]]).T for row in lines)
    first = run.bodies.positions[1]
    axes = list(map_axes(run.true_positions))
    np.testing.assert_allclose(arrow[:2], [first[axes], (first + np.array([0.0, 0.0, 2.0]))[axes]], rtol=1e-3)
    half = 3.0 * np.sqrt(np.diag(P))[axes]
    np.testing.assert_allclose(np.ptp(ellipse, axis=0), 2.0 * half, rtol=0.01)
    np.testing.assert_allclose(ellipse[:-1].mean(axis=0), first[axes], atol=0.01)
    assert len({row["said"] for row in panel.rows("lines") if row["said"] and "body" in row["said"]}) == 2 * 6


def test_every_body_has_a_curve_of_its_nees_over_the_band(runs):
    (panel,) = panels(plot_body_nees([with_bodies(runs[0]), runs[1]]))
    curves = {row["said"]: row["y"] for row in panel.rows("lines") if row["said"] and "body" in row["said"]}
    name = runs[0].filter_name
    assert {said: set(y) for said, y in curves.items()} == {f"{name}, body 0": {0.5}, f"{name}, body 1": {10.0}}
    (band,) = panel.rows("bands")
    assert (band["low"][0], band["high"][0]) == pytest.approx((0.2062, 2.408), rel=1e-3)


@pytest.mark.parametrize("swapped", [False, True])
def test_the_page_says_what_is_true_of_them(runs, tmp_path, monkeypatch, swapped):
    blocks = lambda drawings, _: {one.name: Markup(f"<figure>{one.name}</figure>") for one in drawings}  # noqa: E731
    monkeypatch.setattr("stereo_slam_env.report.page.figure_blocks", blocks)
    shown = [with_bodies(runs[0], swapped=swapped), *runs[1:]]
    text = write_report(tmp_path, "Traffic", shown, *scored(shown), {}).read_text(encoding="utf-8")
    assert (
        "50 % of the frames of 2 bodies are inside the band, and one body alone has 95 % of the sum of all NEES" in text
    )
    share = 100.0 * 9 / 30
    end = f"{share:.1f} % are of a false body" if swapped else "none of them is false, or changes to another true one"
    assert end in text
    assert "Body pose NEES / 6<small>ideal 1</small>" in text
    assert {"bodies_0", "body_nees"} <= {piece.split("<")[0] for piece in text.split("<figure>")[1:]}


def test_without_bodies_there_is_no_word_of_them(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "stereo_slam_env.report.page.figure_blocks", lambda drawings, _: {one.name: "" for one in drawings}
    )
    text = write_report(tmp_path, "Empty street", runs, *scored(runs), {}).read_text(encoding="utf-8")
    assert "Moving bodies" not in text
    assert "odies" not in text.split("<script")[0].split("</style>")[1]
