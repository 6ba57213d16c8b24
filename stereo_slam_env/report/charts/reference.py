"""Chart of the audit of a reference by the images, step by step."""

from __future__ import annotations

import numpy as np

from stereo_slam_env.evaluation.reference_audit import ReferenceAudit
from stereo_slam_env.report.charts.axes import Axis, label_room, panel_width
from stereo_slam_env.report.charts.drawing import Chart, Curve, Panel, figure, limit_of
from stereo_slam_env.report.charts.style import INK, MUTED, PALETTE

DOUBTFUL = "reference doubtful here"
_LEAST = 0.02
"""Lower end of the axis, px: below it nothing is to be told."""


def plot_audit(audit: ReferenceAudit) -> Chart:
    """Median residual of tracks by each step of the reference, and by the images; doubtful steps have a dot."""
    floor = np.maximum([audit.by_reference, audit.by_images], _LEAST)
    lines = [
        Curve("by the images", audit.frames, floor[1], MUTED, width=1.2),
        Curve("by the reference", audit.frames, floor[0], INK, width=1.2),
    ]
    dots = Curve(DOUBTFUL, audit.frames[audit.doubtful], floor[0][audit.doubtful], PALETTE[1])
    colours = {curve.key: curve.colour for curve in (*lines, dots)}
    limit = limit_of(lines, spread=1e3)
    y = Axis(0.8 * float(floor.min()), 1.5 * limit.upper, log=True)
    x = Axis(float(audit.frames[0]) - 1.0, float(audit.frames[-1]) + 1.0, "frame")
    panel = Panel(x, y, panel_width(1, label_room(colours)), 220.0, "Median distance of tracks, left image (px)")
    panel.lines(lines)
    panel.dots([dots])
    panel.colour_key(colours)
    return figure([panel], colours)
