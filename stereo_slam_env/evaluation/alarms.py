"""Whether a monitor would have warned: `filters.monitor` listening to a finished run."""

from __future__ import annotations

import numpy as np

from filters.interface import PoseBelief, UpdateReport
from filters.monitor import Alarm, DivergenceMonitor
from stereo_slam_env.evaluation.results import FilterRun

_COUNTED = {
    **{name: name for name in ("updated", "initialised", "dropped", "gated", "behind_camera")},
    "failed": "failed_factorisations",
}
"""Field of `UpdateReport` with ids: the series of a run that counts them."""


def first_alarm(run: FilterRun) -> Alarm | None:
    """The first alarm of a run, by its innovations and events alone: no truth is used.

    Parameters
    ----------
    run : FilterRun
        Of any filter. What it did after it failed is not looked at.

    Returns
    -------
    Alarm or None
        Its time is from the first frame on, s.
    """
    monitor = DivergenceMonitor()
    steps = np.diff(run.timestamps, prepend=run.timestamps[:1])
    for k, dt in enumerate(steps):
        if not np.isfinite(run.positions[k]).all():
            break
        ids = {name: np.arange(run.counts[series][k]) for name, series in _COUNTED.items() if series in run.counts}
        report = UpdateReport(**ids, nis=float(run.nis[k]), nis_dof=int(run.nis_dof[k]))
        pose = PoseBelief(run.positions[k], run.orientations[k], run.pose_covariances[k])
        if monitor.look(max(float(dt), 0.0), report, pose) is not None:
            break
    return monitor.alarm
