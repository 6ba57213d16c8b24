"""Figure of a learning curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from stereo_slam_env.report.charts.style import MUTED, PALETTE, WIDTH_INCHES, styled

_PANELS = {
    "final_position_sigma_m": "Claimed: position sigma at the end (m)",
    "position_rmse_m": "True: rms position error (m)",
}


@styled
def plot_learning(rows: Sequence[Mapping[str, float]], straight_ahead: Mapping[str, float]) -> Figure:
    """Claimed uncertainty and true error on the validation episodes against the decisions made so far.

    Parameters
    ----------
    rows : sequence of mapping
        Of `LearningCurve.rows`.
    straight_ahead : mapping
        The same values for a head that does not move.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(WIDTH_INCHES, 3.4), layout="constrained")
    thousands = [row["decisions"] / 1000.0 for row in rows]
    best = min(range(len(rows)), key=lambda k: rows[k]["final_pose_logdet"])
    for ax, (name, title) in zip(figure.subplots(1, 2), _PANELS.items(), strict=True):
        values = [row[name] for row in rows]
        ax.plot(thousands, values, color=PALETTE[0])
        ax.plot(thousands[best], values[best], "o", color=PALETTE[0])
        ax.annotate(" kept", (thousands[best], values[best]), color=PALETTE[0], va="top")
        ax.axhline(straight_ahead[name], color=MUTED, linestyle="--")
        ax.text(thousands[-1], straight_ahead[name], "straight ahead", color=MUTED, ha="right", va="bottom")
        ax.set_title(title)
        ax.set_xlabel("decisions, thousands")
        ax.set_ylim(0.0, 1.15 * max(*values, straight_ahead[name]))
    return figure
