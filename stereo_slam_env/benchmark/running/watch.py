"""Look over the shoulder of a scenario's front end."""

from __future__ import annotations

from collections.abc import Callable

from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.streams import make_recording, make_sequence, without_measurements
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.frontend.recorder import ActiveSearch, Watch, record_tracks


def watch_search(scenario: Scenario, watch: Watch, progress: Callable[[int, int], None] | None = None) -> None:
    """Run the front end over the scenario's first seed, guided by the first filter if `search` is "forecast".

    Parameters
    ----------
    scenario : Scenario
        One that takes images.
    watch : callable
        Called with each pair and what was found in it.
    progress : callable, optional
        Called with (pairs done, pairs) after each.

    Raises
    ------
    ValueError
        The scenario has no images, or the filter that guides fails: the message says where.
    """
    seed = scenario.recording_seeds[0]
    sequence, settings = make_sequence(scenario, seed)
    if scenario.search == "flow":
        record_tracks(sequence, settings, frames=scenario.frames, watch=watch, progress=progress)
        return
    recording, choice = make_recording(scenario, seed), scenario.filters[0]
    run = run_filter(
        without_measurements(recording),
        choice.name,
        choice.options,
        common_options=scenario.common_options,
        noise=scenario.assumed_noise(recording.noise),
        use_odometry=scenario.use_odometry,
        observe=ActiveSearch(sequence, settings, watch=watch).observe,
        progress=progress,
    )
    if run.failure is not None:
        raise ValueError(f"the search guided by {choice.label} failed: {run.failure}")
