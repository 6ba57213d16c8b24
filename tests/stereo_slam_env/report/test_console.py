"""The table of results in a terminal, narrow ones included (3 s)."""

import io

import pytest
from rich.console import Console

from stereo_slam_env.evaluation.figures import FIGURES
from stereo_slam_env.report.console import show_results

from ...synthetic_runs import Behaviour, changed, make_runs, scored

LABELS = (
    "coloured-noise",
    "orbslam3+1",
    "orbslam3+2",
    "frame-to-frame",
    "right-invariant",
    "a-label-that-is-quite-long",
)


@pytest.mark.parametrize("width", [60, 80, 200])
@pytest.mark.parametrize("filters", [2, 5, 6], ids=["two columns", "five columns", "a row each"])
def test_no_label_and_no_figure_is_cut(width, filters):
    labels = LABELS[-filters:]
    summaries, _ = scored(make_runs([Behaviour(label, 0.1 + k) for k, label in enumerate(labels)], seeds=range(2)))
    console = Console(file=io.StringIO(), width=width)
    show_results(console, summaries)
    said = console.file.getvalue()
    assert "…" not in said
    assert max(map(len, said.splitlines())) <= width
    for label in labels:
        assert label in said.split()
    for summary in summaries:
        for name in ("position_rmse_m", "pose_anees"):
            assert FIGURES[name].text(getattr(summary, name)) in said.split()
    assert said.count(" of 2") == (filters if filters > 5 else 0)


def test_counts_of_nothing_are_left_out():
    """No zeros of events that did not happen; of two filters one diverges, and both are told how often."""
    found, _ = scored(make_runs([Behaviour("a", 0.1), Behaviour("b", 0.2)], seeds=range(4)))
    for diverged, rows in ((0, 0), (1, 1)):
        console = Console(file=io.StringIO(), width=100)
        show_results(console, [found[0], changed(found[1], diverged=diverged)])
        said = console.file.getvalue()
        assert said.count("diverged runs") == said.count("0 of 4") == said.count("1 of 4") == rows
        for title in ("timed runs", "gated, %", "frames not scored"):
            assert title not in said
