"""The table of results in a terminal, narrow ones included (3 s)."""

import io

import pytest
from rich.console import Console

from stereo_slam_env.evaluation.figures import FIGURES
from stereo_slam_env.report.console import show_results

from ...synthetic_runs import Behaviour, make_runs, scored

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
    assert said.count(" of 2") >= filters  # runs that diverged: the last column
