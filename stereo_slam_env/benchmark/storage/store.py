"""The run directory of one scenario: inputs, results and everything needed to redo the report.

Layout::

    settings.json                         the exact inputs: scenario, versions
    summary.json, summary.csv             the result table
    trials/<seed>/<filter>.npz            time series of one filter on one recording
    bounds/<seed>.npz                     the Cramer-Rao bound: pose (K, 6, 6); empty where there is none
    trajectories/<seed>/<filter>.tum      and truth.tum (<policy>-truth.tum): `t x y z qx qy qz qw`, as TUM RGB-D has it
    trajectories/<seed>/<filter>.kitti    the same as rows of 3x4 matrices, the format of KITTI odometry
    recordings/<stream>/<seed>.npz        what every filter was given, see `stereo_slam_env.recording.archive`
    recordings/<stream>/<seed>.json       what there is to say of it; a policy has its own: <stream> is <label>-<...>

`<seed>` is `seed-0007`, or `recording` for real data. A grid has such a directory for each of its cells, and the
recordings, which cells share, beside them (see `study_store`). `summary.json`, version 2::

    {"version": 2, "scenario": str,
     "recordings": [{"seed": int | null, "name": str, "frames": int, "stream_sha256": str, "assumed_R": 3x3,
                     "reference": {"kind": str, "description": str},  # what estimates are held against, see `Reference`
                     "source": {...},           # with policies: "drive_sha256", and "streams" by label instead
                     "sensor_noise": [...]}],   # rendered images only: errors by range, see `sensor_noise`
     "filters": {<label>: {every field of `FilterSummary` but filter_name}}}

A figure that does not apply is null; NaN and infinity never appear.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import as_given, stream_key
from stereo_slam_env.benchmark.storage.code_identity import code_digest
from stereo_slam_env.benchmark.storage.results import RunResults
from stereo_slam_env.benchmark.storage.run_archive import load_provenance, load_run, write_kitti, write_tum
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.files.atomic import write_atomically
from stereo_slam_env.files.claimed_folder import is_occupied
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.files.readers import read_arrays

VERSION = 2
CELLS = "cells"
STUDY = "study.json"
MARKERS = ("settings.json", STUDY)
_PACKAGES = ("stereo-slam-env", "numpy", "scipy", "gymnasium", "pybullet", "joblib")


class RunDirectory:
    """One run on disk. `open_run` starts or resumes one, `read_run` reads a finished one."""

    def __init__(self, out: Path, scenario: Scenario) -> None:
        self.out = out
        self.scenario = scenario
        self._recordings = root_of(out) / "recordings"

    @property
    def seeds(self) -> tuple[int | None, ...]:
        """One entry a recording; None for real data."""
        return self.scenario.recording_seeds

    def trial_path(self, seed: int | None, choice: FilterChoice) -> Path:
        """Where the time series of one filter on one recording are."""
        return self.out / "trials" / seed_name(seed) / f"{choice.label}.npz"

    def bound_path(self, seed: int | None) -> Path:
        """Where the bound for one recording is."""
        return self.out / "bounds" / f"{seed_name(seed)}.npz"

    def recording_path(self, seed: int | None, choice: FilterChoice | None = None) -> Path:
        """Where the recording is; `choice` matters where a policy drives its own."""
        return self._recordings / stream_key(self.scenario, choice) / f"{seed_name(seed)}.npz"

    def missing(self) -> list[tuple[int | None, FilterChoice | None]]:
        """What is still to be run, by seed, then filter; None instead of a filter: the bound.

        That is what is not there, and what another version of the code made.

        Raises
        ------
        ValueError
            A finished trial is damaged, or was made with other options of the filter.
        """
        todo: list[tuple[int | None, FilterChoice | None]] = []
        code = code_digest()
        for seed in self.seeds:
            for choice in self.scenario.competitors:
                path = self.trial_path(seed, choice)
                provenance = load_provenance(path) if path.exists() else None
                if provenance is None or provenance["code"] != code:
                    todo.append((seed, choice))
                elif provenance["filter"] != dataclasses.asdict(choice):
                    raise ValueError(
                        f"{path} was made with other options of that filter: give it another label, or choose "
                        f"another output directory"
                    )
            if self.scenario.has_bound and self._code_of_bound(seed) != code:
                todo.append((seed, None))
        return todo

    def recording_is_made(self, seed: int | None) -> bool:
        """Whether the recording is there, made by this version of the code."""
        about = self._about_recording(seed)
        return about is not None and about["code"] == code_digest() and self.recording_path(seed).exists()

    def save_recording(
        self, seed: int | None, content: bytes, description: Mapping[str, Any], choice: FilterChoice | None = None
    ) -> None:
        """Keep a recording: bytes of `recording_archive`, and what there is to say of it."""
        path = self.recording_path(seed, choice)
        write_atomically(path, lambda stream: stream.write(content))
        write_json(path.with_suffix(".json"), {"code": code_digest(), **description})

    def provenance(self, seed: int | None, choice: FilterChoice | None) -> dict[str, Any]:
        """What is kept with a trial: competitor, version of the code, what it was given.

        Where a policy drives its own episode, the trial adds what was recorded.
        """
        about: dict[str, Any] = {"filter": choice and dataclasses.asdict(choice), "code": code_digest()}
        if choice is not None and choice.policy is not None:
            return about
        recorded = self._about_recording(seed) or {}
        return {**about, "code": recorded["code"], "recording": as_given(recorded, self.scenario)}

    def save_trial(self, seed: int | None, choice: FilterChoice | None, content: bytes) -> None:
        """Keep a finished trial (bytes of `run_archive`), or a bound."""
        path = self.bound_path(seed) if choice is None else self.trial_path(seed, choice)
        write_atomically(path, lambda stream: stream.write(content))

    def load(self) -> tuple[list[FilterRun], list[dict[str, Any]]]:
        """All runs, by seed, then filter, and one description of each recording.

        Raises
        ------
        ValueError
            A trial is missing or damaged, filters were not given the identical recording, or images were drawn by
            different renderers.
        """
        runs, recordings = [], []
        for seed in self.seeds:
            given: dict[str, dict[str, Any]] = {}
            for choice in self.scenario.competitors:
                path = self.trial_path(seed, choice)
                if not path.exists():
                    raise ValueError(f"{path} is missing: the run is not finished, run the same command again")
                run, provenance = load_run(path)
                if run.filter_name != choice.label:  # it becomes the name of files
                    raise ValueError(f"{path} holds a run of {run.filter_name!r}: delete it and run the command again")
                given[choice.label] = provenance["recording"]
                if pairing_digest(given[choice.label]) != pairing_digest(next(iter(given.values()))):
                    raise ValueError(
                        f"{path}: the filters of {seed_name(seed)} were not given the same recording: "
                        f"its source is not deterministic, or its files have changed; delete {path.parent}"
                    )
                runs.append(run)
            recordings.append({"seed": seed, **_together(given)})
        self._refuse_several_renderers(recordings)
        return runs, recordings

    def bounds(self) -> dict[tuple[str, int | None], Bound]:
        """The bounds there are, by name and seed of the recording."""
        found = {}
        for seed in self.seeds:
            about = self._about_recording(seed)
            if about is None or self._code_of_bound(seed) is None:
                continue
            pose = read_arrays(self.bound_path(seed), ["pose"])["pose"]
            if len(pose):
                found[about["name"], seed] = Bound(pose)
        return found

    def _about_recording(self, seed: int | None) -> dict[str, Any] | None:
        path = self.recording_path(seed).with_suffix(".json")
        if not path.exists():
            return None
        try:
            about: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ValueError(f"{path} is damaged ({error}): delete it and run the same command again") from error
        return about

    def _code_of_bound(self, seed: int | None) -> str | None:
        path = self.bound_path(seed)
        if not path.exists():
            return None
        try:
            return str(read_arrays(path, ["code"])["code"])
        except (OSError, ValueError, KeyError) as error:
            raise ValueError(f"{path} is damaged ({error}): delete it and run the same command again") from error

    def _refuse_several_renderers(self, recordings: list[dict[str, Any]]) -> None:
        """The same renderer of another version or device draws other pictures, too."""
        drawn = {json.dumps(about.get("source", {}).get("renderer"), sort_keys=True) for about in recordings}
        if len(drawn) > 1:
            raise ValueError(
                f"{self.out}: its recordings were drawn by different renderers, {' and '.join(sorted(drawn))}, and are "
                f"not to be compared: choose another output directory"
            )

    def write_results(self) -> RunResults:
        """Write `summary.json`, `summary.csv` and the trajectories, and return what they say."""
        runs, recordings = self.load()
        bounds = self.bounds()
        figures = figures_of(runs, divergence_percent=self.scenario.divergence_percent, bounds=bounds)
        summaries = summarise_all(runs, figures)
        rows = {summary.filter_name: summary_row(summary) for summary in summaries}
        write_json(
            self.out / "summary.json",
            {"version": VERSION, "scenario": self.scenario.name, "recordings": recordings, "filters": rows},
        )
        _write_csv(self.out / "summary.csv", rows)
        looks = bool(self.scenario.policies)  # eyes that look elsewhere are elsewhere, by the arm of the head
        for run in runs:
            folder = self.out / "trajectories" / seed_name(run.seed)
            for name, positions, orientations in (
                (run.filter_name, run.positions, run.orientations),
                (f"{run.filter_name}-truth" if looks else "truth", run.true_positions, run.true_orientations),
            ):
                write_tum(folder / f"{name}.tum", run.timestamps, positions, orientations)
                write_kitti(folder / f"{name}.kitti", positions, orientations)
        return RunResults(tuple(runs), figures, summaries, bounds)

    def settings(self) -> dict[str, Any]:
        """What `settings.json` says."""
        return {"version": VERSION, "scenario": self.scenario.as_dict(), "versions": versions()}


def open_run(out: Path, scenario: Scenario) -> RunDirectory:
    """Start a run, or resume the one in `out`: finished trials of the same settings are kept.

    Raises
    ------
    ValueError
        `out` is a file, or holds something else.
    """
    run = prepared_run(out, scenario)
    write_json(out / "settings.json", run.settings())
    return run


def prepared_run(out: Path, scenario: Scenario) -> RunDirectory:
    """What `open_run` would return, with nothing written yet: to know before long work that `out` can be used.

    Raises
    ------
    ValueError
        As `open_run`.
    """
    refuse_foreign(out)
    if (out / "settings.json").exists():
        _refuse_other_settings(out, read_run(out).scenario.as_dict(), scenario.as_dict())
    run = RunDirectory(out, scenario)
    run.missing()
    return run


def root_of(out: Path) -> Path:
    """The directory that a run shares with others: of a cell that of its grid, else its own."""
    return out.parent.parent if out.parent.name == CELLS else out


def read_run(out: Path) -> RunDirectory:
    """The run in a directory, as its `settings.json` describes it.

    Raises
    ------
    ValueError
        No run there, or its settings are damaged.
    """
    path = out / "settings.json"
    try:
        settings = json.loads(path.read_text(encoding="utf-8"))
        return RunDirectory(out, Scenario.from_dict(settings["scenario"]))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ValueError(_why_no_run(out)) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def refuse_foreign(out: Path) -> None:
    """Raise a `ValueError` where `out` holds something that is no run."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and not any((out / name).exists() for name in MARKERS) and is_occupied(out):
        raise ValueError(f"output {out} is not empty and holds no run: choose another directory")


def _why_no_run(out: Path) -> str:
    """Why there is no run to read, and what could be meant."""
    if not out.is_dir():
        what = "is a file" if out.exists() else "does not exist"
        return f"{out} {what}: give the directory of a run"
    inside = sorted({path.parent for name in MARKERS for path in out.glob(f"*/{name}")})
    if inside:
        return f"{out} holds no run itself, but {len(inside)}: give one of them, such as {inside[-1]}"
    return f"{out} holds no run: it has no settings.json, give the directory of a run"


def versions() -> dict[str, str]:
    """What a run is run with."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "code": code_digest(),
        **{package: version_of(package) for package in _PACKAGES},
    }


def _refuse_other_settings(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """More seeds or filters may join a run; everything else must stay as it was."""
    may_change = {"filters", "policies", "seeds", "divergence_percent", "frame_time_limit", "recording_time_limit"}
    for key in sorted(before.keys() - may_change, key=lambda key: (key == "name", key)):
        was, is_now = before[key], now[key]
        if was == is_now:
            continue
        if isinstance(was, Mapping) and isinstance(is_now, Mapping):  # name the entry, not the lot
            entry = min(entry for entry in {**was, **is_now} if was.get(entry) != is_now.get(entry))
            key, was, is_now = f"{key}.{entry}", was.get(entry), is_now.get(entry)
        raise ValueError(
            f"output {out} holds a run with {key} = {json.dumps(was)}, now it is {json.dumps(is_now)}: "
            f"choose another output directory"
        )


def pairing_digest(about: Mapping[str, Any]) -> str:
    """What must be the same for competitors to be compared: the measurements, or the drive where each one looks."""
    return str(about.get("drive_sha256") or about["stream_sha256"])


def _together(given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What is said of the recordings of a seed, from what each competitor was given."""
    first = dict(next(iter(given.values())))
    if "drive_sha256" not in first:
        return first
    del first["stream_sha256"]
    source = {key: value for key, value in first["source"].items() if key not in ("policy", "filter")}
    return {**first, "source": source, "streams": {label: about["stream_sha256"] for label, about in given.items()}}


def seed_name(seed: int | None) -> str:
    """Name of files of one recording."""
    return "recording" if seed is None else f"seed-{seed:04d}"


def summary_row(summary: FilterSummary) -> dict[str, Any]:
    """JSON-able form of a summary, without its name."""
    row: dict[str, Any] = without_nan(summary.as_dict())
    return row


def without_nan(value: Any) -> Any:
    """JSON form: tuples become lists, NaN and infinity null."""
    if isinstance(value, Mapping):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON that anybody can read, whole or not at all."""
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def _write_csv(path: Path, rows: Mapping[str, Mapping[str, Any]]) -> None:
    text = io.StringIO()
    columns = list(next(iter(rows.values())))
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["filter", *columns])
    for label, row in rows.items():
        table.writerow([label, *(_cell(row[column]) for column in columns)])
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return json.dumps(value) if isinstance(value, (list, dict)) else value
