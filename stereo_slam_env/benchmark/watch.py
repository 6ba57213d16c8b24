"""Look over the shoulder of a scenario's front end."""

from __future__ import annotations

from stereo_slam_env.benchmark.runner import run_filter
from stereo_slam_env.benchmark.scenario import Scenario
from stereo_slam_env.benchmark.sources import make_recording, make_sequence
from stereo_slam_env.frontend.active_search import ActiveSearch
from stereo_slam_env.frontend.recorder import Watch, record_tracks


def watch_search(scenario: Scenario, watch: Watch) -> None:
    """Run the front end over the scenario's first seed, guided by the first filter if `search` is "forecast".

    Parameters
    ----------
    scenario : Scenario
        One that takes images.
    watch : callable
        Called with each pair and what was found in it.

    Raises
    ------
    ValueError
        The scenario has no images.
    """
    seed = scenario.seeds[0] if scenario.kind == "street" else None
    sequence, settings = make_sequence(scenario, seed)
    if scenario.search == "flow":
        record_tracks(sequence, settings, frames=scenario.frames, watch=watch)
        return
    choice = scenario.filters[0]
    run_filter(
        make_recording(scenario, seed),
        choice.name,
        choice.options,
        common_options=scenario.common_options,
        noise=None,
        use_odometry=scenario.use_odometry,
        observe=ActiveSearch(sequence, settings, watch=watch).observe,
    )
