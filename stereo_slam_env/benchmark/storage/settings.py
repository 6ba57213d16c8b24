"""Settings of a run in its directory, and descriptions of the recordings that its filters were given.

They tell what is a run, and what may change where it is resumed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.scenarios.streams import seed_description
from stereo_slam_env.files.folders import is_occupied
from stereo_slam_env.files.readers import read_json

SETTINGS, STUDY = "settings.json", "study.json"


def refuse_foreign(out: Path) -> None:
    """Raise a `ValueError` where `out` holds something that is no run."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and not holds_run(out) and is_occupied(out):
        raise ValueError(f"output {out} is not empty and holds no run: choose another directory")


def holds_run(out: Path) -> bool:
    """Whether a directory holds a study or settings of ours.

    Other programs have files of these names, too. A `ValueError` says that one is no JSON.
    """
    settings = _content(out / SETTINGS)
    known = isinstance(settings.get("scenario"), dict) and ("kind" in settings["scenario"] or "versions" in settings)
    return known or isinstance(_content(out / STUDY).get("cells"), list)


def _content(path: Path) -> dict[str, Any]:
    content = read_json(path) if path.exists() else None
    return content if isinstance(content, dict) else {}


def why_no_run(out: Path) -> str:
    """Error message where there is no run to read, with a suggestion."""
    if not out.is_dir():
        what = "is a file" if out.exists() else "does not exist"
        return f"{out} {what}: give the directory of a run"
    inside = sorted({path.parent for name in (SETTINGS, STUDY) for path in out.glob(f"*/{name}")})
    if inside:
        return f"{out} holds no run itself, but {len(inside)}: give one of them, such as {inside[-1]}"
    return f"{out} holds no run: it has no settings.json, give the directory of a run"


def refuse_other_settings(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise a `ValueError` where anything but seeds, filters or limits differs from the settings of the run."""
    may_change = {"filters", "policies", "seeds", "divergence_percent", "frame_time_limit", "recording_time_limit"}
    may_change |= {"kept_seeds"}
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


Given = dict[int | None, dict[str, dict[str, Any]]]
"""Descriptions of the recordings, by seed, then label of the filter."""


def descriptions(out: Path, given: Given) -> list[dict[str, Any]]:
    """One description of each recording; a `ValueError` says that they were drawn by different renderers."""
    recordings = [{"seed": seed, **seed_description(of_seed)} for seed, of_seed in given.items()]
    # The same renderer of another version or device draws other pictures, too.
    drawn = {json.dumps(about.get("source", {}).get("renderer"), sort_keys=True) for about in recordings}
    if len(drawn) > 1:
        raise ValueError(
            f"{out}: its recordings were drawn by different renderers, {' and '.join(sorted(drawn))}, and are "
            f"not to be compared: choose another output directory"
        )
    return recordings
