"""Run directory of a study: inputs, results and everything needed to redo the report.

What lies where, and the schema of `summary.json`, is in docs/benchmark.md ("The run directory"). `<seed>` in the names
of files is `seed-0007`, or `recording` for real data; beside each recording (npz) there is what there is to say of it
(JSON). A figure that does not apply is null; NaN and infinity never appear.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import as_given, pairing_digest, stream_key
from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.benchmark.storage.code_identity import code_digest, digest_of_choice, digest_of_source, versions
from stereo_slam_env.benchmark.storage.run_files import (
    SETTINGS,
    STUDY,
    Given,
    StoredRun,
    damage_named,
    descriptions,
    holds_run,
    load_bound,
    load_provenance,
    load_run,
    refuse_foreign,
    refuse_other_settings,
    seed_name,
    why_no_run,
    write_trajectories,
)
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_figures import (
    RunKey,
    RunScore,
    score_of,
)
from stereo_slam_env.files.folders import write_atomically, write_json
from stereo_slam_env.files.opening import read_bytes, require_links_inside
from stereo_slam_env.files.readers import read_json

VERSION = 2
CELLS = "cells"
_OF_COMPETITORS = ("filters", "policies", "name")
"""Keys of a scenario that have no share in its recordings."""
_WRITTEN = (
    *(SETTINGS, STUDY, "summary.json", "summary.csv", "trials.sqlite", "report.html", "comparison.html", CELLS),
    *("trials", "bounds", "recordings", "trajectories", "figures", "tables"),
)
"""Entries of a run directory; anything else in it is the user's."""


class RunDirectory:
    """Directory of one cell, as `StudyDirectory.cells` has it."""

    def __init__(self, out: Path, cell: Cell, root: Path) -> None:
        self.out = out
        self.cell = cell
        self.scenario = cell.scenario
        self.seeds = cell.scenario.recording_seeds
        self._root = root
        self._recordings = self._root / "recordings"
        self._kept = frozenset(self.seeds[: cell.scenario.kept_seeds])
        self._found_code: dict[str | None, str | None] | None = None
        self._streams: dict[str | None, str] = {}

    def trial_path(self, seed: int | None, choice: FilterChoice) -> Path:
        """File of the time series of one filter on one recording."""
        return self.out / "trials" / seed_name(seed) / f"{choice.label}.npz"

    def bound_path(self, seed: int | None) -> Path:
        """File of the bound for one recording."""
        return self.out / "bounds" / f"{seed_name(seed)}.npz"

    def recording_path(self, seed: int | None, choice: FilterChoice | None = None) -> Path:
        """File of the recording; `choice` matters where a policy drives its own episode."""
        label = None if choice is None else choice.label
        if label not in self._streams:  # a campaign asks for thousands of paths
            self._streams[label] = stream_key(self.scenario, choice)
        return self._recordings / self._streams[label] / f"{seed_name(seed)}.npz"

    def missing(self) -> list[tuple[int | None, FilterChoice | None]]:
        """Trials still to be run, by seed, then filter; None instead of a filter: the bound.

        That is what is not there, and what other code made, be it ours or that of filter, policy or source. A
        `ValueError` says that a finished trial is damaged, or was made with other options of the filter.
        """
        todo: list[tuple[int | None, FilterChoice | None]] = []
        code = code_digest()
        self._found_code = None  # files may have been edited since
        for seed in self.seeds:
            for choice in self.scenario.competitors:
                path = self.trial_path(seed, choice)
                provenance, is_whole = load_provenance(path, inside=self._root) if path.exists() else ({}, False)
                other_code = _code_in(provenance) != (code, self._plugins[choice.label])
                if other_code or (self.keeps(seed) and not is_whole):
                    todo.append((seed, choice))
                elif provenance["filter"] != to_builtins(choice):
                    raise ValueError(
                        f"{path} was made with other options of that filter: give it another label, or choose "
                        f"another output directory"
                    )
            needed = self.keeps(seed) or (todo and todo[-1][0] == seed)
            if self.scenario.has_bound and needed and self._bound(seed)[1] != self._code_of_bound:
                todo.append((seed, None))
        return todo

    @property
    def _plugins(self) -> dict[str | None, str | None]:
        """Digests of the code that is not ours, by label of the competitor; of None that of the recordings alone.

        To know them, filters are imported: nobody who only reads a run asks for them.
        """
        if self._found_code is None:
            settings = {key: value for key, value in self.scenario.as_dict().items() if key not in _OF_COMPETITORS}
            source = digest_of_source(self.scenario.source, settings)
            self._found_code = {None: source}
            for choice in self.scenario.competitors:
                theirs = " ".join(filter(None, (source, digest_of_choice(choice))))
                self._found_code[choice.label] = theirs or None
        return self._found_code

    @property
    def _code_of_bound(self) -> str:
        return " ".join(filter(None, (code_digest(), self._plugins[None])))

    def recording_is_made(self, seed: int | None) -> bool:
        """Whether the recording is there, made by this version of the code."""
        about = self._about_recording(seed) or {}
        return _code_in(about) == (code_digest(), self._plugins[None]) and self.recording_path(seed).exists()

    def recording_content(self, seed: int | None) -> bytes:
        """Recording of a seed, as bytes of `recording.archive`."""
        return read_bytes(self.recording_path(seed), inside=self._root)

    def save_recording(
        self, seed: int | None, content: bytes, description: Mapping[str, Any], choice: FilterChoice | None = None
    ) -> None:
        """Keep a recording, as bytes of `recording.archive`, and its description."""
        path = self.recording_path(seed, choice)
        write_atomically(path, lambda stream: stream.write(content))
        code = {"code": code_digest(), "plugin_code": self._plugins[None]}
        write_json(path.with_suffix(".json"), {**code, **description})

    def provenance(self, seed: int | None, choice: FilterChoice | None) -> dict[str, Any]:
        """Provenance of a trial: competitor, identity of our code and of others', description of its recording.

        Where a policy drives its own episode, the trial adds what was recorded.
        """
        about: dict[str, Any] = {
            "filter": choice and to_builtins(choice),
            "code": code_digest(),
            "plugin_code": self._plugins[None if choice is None else choice.label],
        }
        if choice is not None and choice.policy is not None:
            return about
        recorded = self._about_recording(seed) or {}
        code = self._code_of_bound if choice is None else recorded["code"]
        return {**about, "code": code, "recording": as_given(recorded, self.scenario)}

    def save_trial(self, seed: int | None, choice: FilterChoice | None, content: bytes) -> None:
        """Keep a finished trial (bytes of `run_files`), or a bound."""
        path = self.bound_path(seed) if choice is None else self.trial_path(seed, choice)
        write_atomically(path, lambda stream: stream.write(content))

    def load(self) -> tuple[list[FilterRun], list[dict[str, Any]]]:
        """All runs, by seed, then filter, and one description of each recording; raises as `trials`."""
        given: Given = {}
        by_filter = [[stored.run for stored in self.trials(choice, given)] for choice in self.scenario.competitors]
        return [run for of_seed in zip(*by_filter, strict=True) for run in of_seed], descriptions(self.out, given)

    def trials(self, choice: FilterChoice, given: Given) -> Iterator[StoredRun]:
        """Trials of a competitor, by seed, with their figures; what it was `given` is noted there.

        A `ValueError` says that a trial is missing or damaged, that this competitor was not given the recordings of
        those before it, or that images were drawn by different renderers.
        """
        for seed in self.seeds:
            path = self.trial_path(seed, choice)
            if not path.exists():
                raise ValueError(f"{path} is missing: the run is not finished, run the same command again")
            stored = load_run(path, inside=self._root)
            if stored.run.filter_name != choice.label:  # it becomes the name of files
                raise ValueError(
                    f"{path} holds a run of {stored.run.filter_name!r}: delete it and run the command again"
                )
            about, of_seed = stored.provenance["recording"], given.setdefault(seed, {})
            if of_seed and pairing_digest(about) != pairing_digest(next(iter(of_seed.values()))):
                raise ValueError(
                    f"{path}: the filters of {seed_name(seed)} were not given the same recording: "
                    f"its source is not deterministic, or its files have changed; delete {path.parent}"
                )
            # Of what is the same for all one description will do.
            of_seed[choice.label] = about if self.scenario.policies or not of_seed else next(iter(of_seed.values()))
            yield replace(stored, score=self._score(stored, seed))

    def _score(self, found: StoredRun, seed: int | None) -> RunScore:
        """Figures of a trial: those that are kept with it, or of a whole one that has none, computed."""
        limit = self.scenario.divergence_percent
        if found.score is not None:
            return found.score.judged(limit)
        if not found.is_whole:
            raise ValueError(
                f"{self.out}: figures of {seed_name(seed)} were kept by another version, without the time series: run "
                f"the same command again"
            )
        return score_of(found.run, divergence_percent=limit, bound=self.bound(seed))

    def plugin_code(self) -> dict[str, str | None]:
        """Digest of the code that each filter and policy had, by label; None for those that are ours."""
        return {
            choice.label: load_provenance(self.trial_path(self.seeds[0], choice))[0].get("plugin_code")
            for choice in self.scenario.competitors
        }

    def bounds(self) -> dict[RunKey, Bound]:
        """The bounds that are kept, by name and seed of the recording."""
        found = {}
        for seed in self.seeds[: self.scenario.kept_seeds]:
            about, bound = self._about_recording(seed), self.bound(seed)
            if about is not None and bound is not None:
                found[about["name"], seed] = bound
        return found

    def bound(self, seed: int | None) -> Bound | None:
        """The bound for a recording, where there is one."""
        return self._bound(seed)[0]

    def _bound(self, seed: int | None) -> tuple[Bound | None, str | None]:
        """The bound, and the version of the code that made it; None where there is none."""
        path = self.bound_path(seed)
        return load_bound(path, inside=self._root) if path.exists() else (None, None)

    def keeps(self, seed: int | None) -> bool:
        """Whether recording and time series of a seed are kept."""
        return seed in self._kept

    def remove_recordings(self, seeds: Iterable[int | None]) -> None:
        """Remove the recordings and bounds of these seeds: figures have been made of them."""
        for seed in seeds:
            paths = [self.recording_path(seed, choice) for choice in (None, *self.scenario.competitors)]
            for path in [*paths, *(path.with_suffix(".json") for path in paths), self.bound_path(seed)]:
                path.unlink(missing_ok=True)

    def _about_recording(self, seed: int | None) -> dict[str, Any] | None:
        path = self.recording_path(seed).with_suffix(".json")
        if not path.exists():
            return None
        with damage_named(path):
            about: dict[str, Any] = read_json(path, inside=self._root)
            _ = about["name"].encode(), about.get("code")
            return about

    def audits(self) -> dict[str, ReferenceAudit]:
        """What the images say of the references of the recordings that are kept, by name of the recording."""
        abouts = [about for seed in self.seeds if (about := self._about_recording(seed)) is not None]
        with damage_named(self.out):
            return {about["name"]: ReferenceAudit.from_dict(about["audit"]) for about in abouts if about.get("audit")}

    def recording_words(self) -> dict[str, dict[str, str]]:
        """What is said of real recordings that are kept, by name of the recording."""
        abouts = [about for seed in self.seeds if (about := self._about_recording(seed)) is not None]
        with damage_named(self.out):
            return {about["name"]: {**about["words"]} for about in abouts if about.get("words")}

    def write_trajectories(self) -> None:
        """Write the trajectories of all recordings that are kept; raises as `trials`."""
        for choice in self.scenario.competitors:
            runs = (stored.run for stored in self.trials(choice, {}) if stored.is_whole)
            write_trajectories(self.out, self.scenario, runs)

    def settings(self) -> dict[str, Any]:
        """Content of `settings.json`."""
        return {"version": VERSION, "scenario": self.scenario.as_dict(), "versions": versions()}


class StudyDirectory:
    """Run directory `out` of a study. `prepared_study` starts or resumes one, `read_study` reads one.

    `cells` has a `RunDirectory` for each cell; that of a study of one scenario is `out` itself. `root` is the directory
    that the run shares with others: of a cell that of its grid.
    """

    def __init__(self, out: Path, study: Study) -> None:
        self.out = out
        self.study = study
        self.root = out if study.is_grid else root_of(out)
        places = [out / CELLS / cell.name if study.is_grid else out for cell in study.cells]
        self.cells = tuple(
            RunDirectory(place, cell, self.root) for place, cell in zip(places, study.cells, strict=True)
        )

    def write_settings(self) -> StudyDirectory:
        """Write the study and the settings of its cells, where it is started or resumed; returns itself."""
        write_json(self.out / STUDY, self.study.as_dict())
        for run in self.cells:
            write_json(run.out / SETTINGS, run.settings())
        return self

    def write_trajectories(self) -> None:
        """Write the trajectories of all recordings that are kept."""
        for directory in self.cells:
            directory.write_trajectories()


def _code_in(provenance: Mapping[str, Any]) -> tuple[str | None, str | None]:
    """Digests of our code and of that of the filter and policy that made a trial."""
    return provenance.get("code"), provenance.get("plugin_code")


def prepared_study(out: Path, study: Study) -> StudyDirectory:
    """Directory for a study, with nothing written yet: a check of `out` before long work.

    A `ValueError` says that `out` is a file, holds something else, or a run with other settings.
    """
    refuse_foreign(out)
    if (out / STUDY).exists():
        before = read_study(out).study
        if study.is_grid != before.is_grid:
            raise ValueError(f"output {out} holds a run of {before.name!r}: choose another output directory")
    directory = StudyDirectory(out, study)
    for run in directory.cells:
        refuse_foreign(run.out)
        if (run.out / SETTINGS).exists():
            refuse_other_settings(run.out, _scenario_in(run.out).as_dict(), run.scenario.as_dict())
    return directory


def read_study(out: Path) -> StudyDirectory:
    """The study in a directory, be it one cell of a grid; a `ValueError` says what is missing or damaged."""
    path = out / STUDY
    if not path.exists():
        return StudyDirectory(out, Study.of(_scenario_in(out)))
    _require_run(out, path)
    require_links_inside(out, only=_WRITTEN)  # what is written would land elsewhere, too
    with damage_named(path):
        return StudyDirectory(out, Study.from_dict(read_json(path)))


def root_of(out: Path) -> Path:
    """The directory that a run shares with others: of a cell that of its grid, whose study names it, else its own."""
    grid = out.absolute().parents[1:2]
    if out.absolute().parent.name != CELLS or not grid:
        return out
    try:
        names = [cell["name"] for cell in read_json(grid[0] / STUDY)["cells"]]
    except (OSError, ValueError, KeyError, TypeError):
        return out
    if out.absolute().name not in names:
        return out
    return out.parent.parent if len(out.parts) > 1 else grid[0]


def _scenario_in(out: Path) -> Scenario:
    path = out / SETTINGS
    _require_run(out, path)
    require_links_inside(root_of(out), only=_WRITTEN)
    try:
        with damage_named(path):
            return Scenario.from_dict(read_json(path)["scenario"])
    except FileNotFoundError as error:
        raise ValueError(why_no_run(out)) from error


def _require_run(out: Path, path: Path) -> None:
    """Raise a `ValueError` where `out` holds no run, or its file `path` is no JSON."""
    with damage_named(path):
        is_run = out.is_dir() and holds_run(out)
    if not is_run:
        raise ValueError(why_no_run(out))
