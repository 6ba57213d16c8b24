"""Functions of the public face that join several rooms: record, evaluate, compare.

The simulator and the charts are imported where they are used: recordings are evaluated without them.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.console import Console

from filters import StereoNoise
from filters.catalogue.registry import label_of, require_filter, usual_options
from filters.contract.validation import whole_number
from stereo_slam_env.benchmark.head_to_head import FilterLike, HeadToHead, which_seeds
from stereo_slam_env.benchmark.scenarios import streams
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import preset
from stereo_slam_env.benchmark.statistics.verdict import Verdict, judge
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, figures_of, summarise_all
from stereo_slam_env.recording import notebook_html as html
from stereo_slam_env.recording.filter_setup import FilterSetup
from stereo_slam_env.recording.recording import Recording, require_frames
from stereo_slam_env.report.console import progress_bar, show_results


def record(
    environment: str = "StereoSlam/Drive-v0",
    seed: int = 0,
    *,
    policy: str = "route",
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
    **arguments: Any,
) -> Recording:
    """Record an episode of an environment: a measurement stream that any number of filters can then be run on.

    Parameters
    ----------
    environment : str
        Id of one of the environments of this package.
    seed : int
        Of the episode: same seed, same bits.
    policy : str
        "route": the vehicle follows its scripted route; where the head can turn, it looks straight ahead. Or the name
        of a policy of `available_policies()` that turns the head and needs no filter.
    frames : int, optional
        Stop after this many; None: at the end of the route.
    progress : callable, optional
        Called after each frame with the number of frames so far and the number wanted (None: not known).
    **arguments
        Of the environment.

    Returns
    -------
    Recording
        With truth; `source` says how to make it again.

    Raises
    ------
    ValueError
        An argument is unknown or impossible, or the drive ended before `frames`.
    """
    import gymnasium as gym

    from stereo_slam_env.envs.recorder import record as record_route
    from stereo_slam_env.policies.named_policies import make_policy
    from stereo_slam_env.policies.policy_rows import run_episode

    whole_number("seed", seed, 0)
    if environment == "StereoSlam/Drive-v0":
        return record_route({"policy": policy, **arguments}, seed, frames, progress)
    env = gym.make(environment, disable_env_checker=True, **{"max_episode_steps": -1, **arguments})
    try:
        driver = make_policy("fixed" if policy == "route" else policy)
        episode = run_episode(env, driver, seed, frames=frames, progress=progress)
    finally:
        env.close()
    if episode.failure is not None:
        raise ValueError(f"policy {policy!r} cannot be recorded in {environment}: {episode.failure}")
    return episode.recording


def make_recording(scenario: str | Scenario, seed: int | None = 0) -> Recording:
    """The recording of a scenario for a seed; it states how the scenario sets filters up.

    Parameters
    ----------
    scenario : str or Scenario
        Name of a preset, or a scenario.
    seed : int, optional
        Of the recording; None for real data.

    Raises
    ------
    ValueError
        An unknown preset, a source that cannot be used, or a scenario in whose images each filter searches itself.
    """
    return _recorded(preset(scenario) if isinstance(scenario, str) else scenario, seed)


def _recorded(scenario: Scenario, seed: int | None) -> Recording:
    if scenario.search == "forecast":
        raise ValueError(
            f"search 'forecast' has no recording, each filter of {scenario.name!r} measures for itself: use "
            "run_benchmark, or search='flow'"
        )
    return streams.make_recording(scenario, seed)


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """One filter on one recording."""

    figures: FilterSummary
    """All figures; None where something is not known, such as an error without truth."""
    series: FilterRun
    """Estimates, errors, covariances and counts, frame by frame."""
    setup: FilterSetup
    """How the filter was set up; what it was made with is `series.options`."""

    def __repr__(self) -> str:
        return f"{_table([self.figures])}\n{self.setup}\n"

    def _repr_html_(self) -> str:
        return html.fixed_width(str(self))


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Filters on identical recordings."""

    title: str
    """What they ran on."""
    runs: tuple[FilterRun, ...]
    """One for each filter and recording."""
    figures: Figures
    """Figures of every run, by label of the filter."""
    summaries: tuple[FilterSummary, ...]
    """Figures over all runs, one for each filter."""
    settings: Mapping[str, Any]
    """The exact inputs, JSON-able."""

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict: the best filter, by how much, and whether that is shown; its `headline` is a few sentences."""
        return judge(self.summaries, self.figures)

    @property
    def table(self) -> str:
        """The result table as text, a column a filter."""
        return _table(self.summaries)

    def __repr__(self) -> str:
        return f"{self.title}\n\n{self.table}\n{self.verdict.headline}"

    def _repr_html_(self) -> str:
        from stereo_slam_env.report.pictures import show_nees

        scored = any(summary.pose_anees is not None for summary in self.summaries)
        chart = show_nees(self).svg() if scored else ""
        return html.heading(self.title) + html.fixed_width(self.table) + self.verdict._repr_html_() + chart

    def report(self, folder: str | Path) -> Path:
        """Write the report with its figures into `folder`; returns the page to open."""
        from stereo_slam_env.report.run_report import write_report

        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        return write_report(out, self.title, self.runs, self.summaries, self.figures, self.settings)

    def between(self, label: str, reference: str) -> HeadToHead:
        """One filter against another one, with the assertions of a unit test.

        Raises
        ------
        ValueError
            There is no filter with that label.
        """
        by_label = {summary.filter_name: summary for summary in self.summaries}
        for name in (label, reference):
            if name not in by_label:
                raise ValueError(f"label must be one of {', '.join(by_label)}, got {name!r}")
        runs = tuple(run for run in self.runs if run.filter_name == label)
        figures = self.figures[label], self.figures[reference]
        return HeadToHead(by_label[label], by_label[reference], runs, *figures, self.title)


def evaluate(
    slam: FilterLike,
    recording: Recording,
    *,
    noise: StereoNoise | None = None,
    use_odometry: bool | None = None,
    divergence_percent: float | None = None,
    **options: Any,
) -> Evaluation:
    """All figures of one filter on one recording, and its estimates frame by frame.

    The filter is set up as the recording states (`Recording.filter_setup`), but for what is given here.

    Parameters
    ----------
    slam : str or callable
        A name of `filters.available_filters()`, or a filter class or function.
    recording : Recording
        The stream.
    noise : StereoNoise, optional
        Noise to assume; None: what the recording states.
    use_odometry : bool, optional
        Whether the filter is given the odometry of the recording; None: what that states.
    divergence_percent : float, optional
        A run that ends farther from the truth than this share of the path has diverged; None: what is stated.
    **options
        Of the filter.

    Returns
    -------
    Evaluation
        A filter that raises is a result, too: `figures.failures` says what happened.

    Raises
    ------
    ValueError
        The recording is empty, or no filter or option has that name.
    """
    require_frames(recording)
    arguments: dict[str, Any] = {"use_odometry": use_odometry, "divergence_percent": divergence_percent}
    setup = replace(recording.filter_setup, **{name: value for name, value in arguments.items() if value is not None})
    recording = replace(recording, stated_setup=setup)
    setup = recording.filter_setup
    options = {**usual_options(slam), **options}
    require_filter(slam, options)
    run = run_filter(recording, slam, options, noise=noise)
    (summary,) = summarise_all([run], figures_of([run], divergence_percent=setup.divergence_percent))
    return Evaluation(summary, run, setup)


def compare(
    filters: Sequence[FilterLike],
    scenario: str | Scenario | Recording | Sequence[Recording] = "quick",
    *,
    seeds: int | Sequence[int] = 10,
    frames: int | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Run filters on identical recordings, in this process, and compare them.

    For long comparisons that can be interrupted and resumed, on many cores, see `run_benchmark`.

    Parameters
    ----------
    filters : sequence of str or callable
        Names of `filters.available_filters()`, filter classes or functions.
    scenario : str, Scenario, Recording or sequence of Recording
        Name of a preset, a scenario (its own filters and seeds play no part), or recordings.
    seeds : int or sequence of int
        How many recordings of a scenario, or which.
    frames : int, optional
        Frames of each recording; None: as many as the scenario has.
    options : mapping of str to mapping, optional
        Options by label of the filter (its name, or that of its class or function), JSON-able.
    progress : callable, optional
        Called with (runs done, runs); None: a bar where stderr is a terminal.

    Raises
    ------
    ValueError
        No filters, two with the same label, options for none of them, no seeds, an unknown preset, filter or option.
    """
    labels = [label_of(one) for one in filters]
    if not labels or len(set(labels)) < len(labels):
        raise ValueError(f"filters must be at least one, with different labels, got {', '.join(labels) or 'none'}")
    options_by_label = dict(options or {})
    for label in options_by_label:
        if label not in labels:
            raise ValueError(f"options must be for one of {', '.join(labels)}, got {label!r}")
    filter_options = {
        label: {**usual_options(one), **options_by_label.get(label, {})}
        for label, one in zip(labels, filters, strict=True)
    }
    for label, one in zip(labels, filters, strict=True):
        require_filter(one, filter_options[label])  # before any work
    on = preset(scenario) if isinstance(scenario, str) else scenario
    if isinstance(on, Scenario):
        which = which_seeds(seeds)
        recordings: Iterator[tuple[int | None, Recording]] = ((seed, _recorded(on, seed)) for seed in which)
        count, title = len(which), on.name
        about: dict[str, Any] = {"scenario": on.as_dict()}
    else:
        given_recordings = [on] if isinstance(on, Recording) else list(on)
        alone = len(given_recordings) == 1
        recordings = ((None if alone else number, one) for number, one in enumerate(given_recordings))
        count, title = len(given_recordings), ", ".join(dict.fromkeys(one.name for one in given_recordings))
        about = {"scenario": {"recordings": [dict(one.source) for one in given_recordings]}}
    runs: list[FilterRun] = []
    setups: dict[str, FilterSetup] = {}
    bar = progress_bar(Console(stderr=True), "runs") if progress is None and sys.stderr.isatty() else None
    with bar or nullcontext(progress or (lambda done, total: None)) as tell:
        for seed, recording in recordings:
            if frames is not None:
                recording = recording[:frames]
            setups[str(recording.filter_setup)] = recording.filter_setup
            for label, one in zip(labels, filters, strict=True):
                runs.append(run_filter(recording, one, filter_options[label], label=label, seed=seed))
                tell(len(runs), count * len(labels))
    limits = {setup.divergence_percent for setup in setups.values()}
    if len(limits) != 1:
        raise ValueError(f"recordings must state one divergence_percent, got {sorted(limits)}")
    figures = figures_of(runs, divergence_percent=limits.pop())
    about["filter setup"] = ", or ".join(setups)
    about["options"] = {run.filter_name: dict(run.options) for run in runs}
    return Comparison(title, tuple(runs), figures, tuple(summarise_all(runs, figures)), about)


def _table(summaries: Sequence[FilterSummary]) -> str:
    text = io.StringIO()
    show_results(Console(file=text, width=120, force_jupyter=False, force_terminal=False), summaries)
    return text.getvalue()
