"""Files of many runs, one for each seed, by a pattern with `{seed}` in the place of a name or a part of one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

SEED = "{seed}"
"""The placeholder: any text within one name of a folder or file, the same wherever it stands."""
TRUTHS = ("mav0/state_groundtruth_estimate0/data.csv", "truth_body.tum", "state_groundtruth.txt")
"""Truths of the body that stand in the folder of a drive, first those to be preferred."""
_SHOWN = 8
"""Seeds that a message lists."""


@dataclass(frozen=True)
class SeedFiles:
    """Estimates and truths of runs that belong together."""

    pairs: Mapping[str, tuple[Path, Path]]
    """Estimate and truth by seed."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Seeds with a truth and without an estimate, and what is missing."""


def has_seed(path: Path) -> bool:
    """Whether a path is a pattern."""
    return SEED in str(path)


def seed_files(estimate: Path, truth: Path | None = None) -> SeedFiles:
    """Find the estimates that a pattern names, and the truth of each.

    Parameters
    ----------
    estimate : Path
        Pattern of the estimates.
    truth : Path, optional
        Pattern of the truths, or one truth of all. None: that in the folder of each estimate, see `TRUTHS`.

    Raises
    ------
    ValueError
        No file is there, or seeds have an estimate and no truth: one line that names them.
    """
    if not has_seed(estimate):
        raise ValueError(f"{estimate} is one estimate: write {SEED} for what differs between the runs")
    estimates, folders = _matches(estimate)
    if truth is None:
        truths = {seed: at for seed in folders if (at := truth_beside(_filled(estimate, seed))) is not None}
        where = f"none of {', '.join(TRUTHS)} is in the folder"
    elif has_seed(truth):
        truths, where = _matches(truth)[0], f"{truth} is not there"
    else:
        truths, where = dict.fromkeys(folders, truth), ""
    if not estimates:
        raise ValueError(f"{estimate} matches no file: is {SEED} in the right place?")
    if lonely := [seed for seed in estimates if seed not in truths]:
        raise ValueError(f"no truth for {SEED} = {_listed(lonely)}: {where}; every run needs one")
    missing = {seed: f"no estimate: {estimate} is not there" for seed in truths if seed not in estimates}
    return SeedFiles({seed: (path, truths[seed]) for seed, path in estimates.items()}, missing)


def truth_beside(estimate: Path) -> Path | None:
    """The truth in the folder of an estimate; None where there is none."""
    return next((at for name in TRUTHS if (at := estimate.parent / name).is_file() and at != estimate), None)


def _matches(pattern: Path) -> tuple[dict[str, Path], list[str]]:
    """Files that a pattern names by seed, and all seeds whose folder or file is there, in the order of numbers."""
    parts = pattern.parts
    at = next(i for i, part in enumerate(parts) if SEED in part)
    head, *more = map(re.escape, parts[at].split(SEED))
    name = re.compile(f"{head}(?P<seed>.+){'(?P=seed)'.join(more)}", re.DOTALL)
    folder = Path(*parts[:at])
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: {pattern} has nothing to match")
    seeds = [match["seed"] for one in folder.iterdir() if (match := name.fullmatch(one.name))]
    if at < len(parts) - 1:
        seeds = [seed for seed in seeds if (folder / parts[at].replace(SEED, seed)).is_dir()]
    seeds.sort(key=lambda seed: [(int(part) if part.isdecimal() else -1, part) for part in re.split(r"(\d+)", seed)])
    return {seed: path for seed in seeds if (path := _filled(pattern, seed)).exists()}, seeds


def _filled(pattern: Path, seed: str) -> Path:
    return Path(*(part.replace(SEED, seed) for part in pattern.parts))


def _listed(seeds: list[str]) -> str:
    more = f" and {len(seeds) - _SHOWN} more" if len(seeds) > _SHOWN else ""
    return ", ".join(seeds[:_SHOWN]) + more
