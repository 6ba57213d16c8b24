"""A line joins its points in the order in which they are given (1 s)."""

import re

import numpy as np

from stereo_slam_env.report.charts.axes import Axis
from stereo_slam_env.report.charts.drawing import Curve, Panel, figure


def test_a_path_that_turns_back_is_drawn_as_it_was_driven(tmp_path):
    """A circle: neighbours are a twelfth of the way round apart, and the line ends where it began."""
    angles = np.linspace(0.0, 2.0 * np.pi, 13)
    panel = Panel(Axis(-2.0, 2.0, "x"), Axis(-2.0, 2.0), 200.0, 200.0)
    panel.lines([Curve("", np.cos(angles), np.sin(angles), "#123456")])
    figure([panel]).save(tmp_path / "circle.svg")
    (line,) = re.findall(r'<path d="([^"]*)"[^>]*#123456', (tmp_path / "circle.svg").read_text(encoding="utf-8"))
    points = np.array([[float(x) for x in point.split(",")] for point in re.split("[ML]", line)[1:]])
    assert len(points) == 13
    np.testing.assert_allclose(points[0], points[-1], atol=1e-3)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(steps, 50.0 * 2.0 * np.sin(np.pi / 12.0), rtol=0.01)
