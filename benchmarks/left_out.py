"""The size of the gauge walk, chosen on all recordings but one of a kind and judged on that one.

    python benchmarks/left_out.py DATA --rendered 2                              # some ten minutes
    python benchmarks/left_out.py --rendered 2 --routes right-turn --renderers gl

Two constants of `stereo_slam_env/frontend/track_noise.py` size it: `COMMON_WALK` for tracks that bring no covariance,
`COMMON_WALK_WITH_R` for those that do. For each recording that value is taken which gives the others of its kind, and
all their changes of `changed_recordings.py`, the best mean log score of windows of 1 s and 10 s. NEES/6 of the pose and
of windows on the one that was left out should be 1. Vision only.

Rendered drives have an exact lens, rig and truth. They are judged as a stranger's, to whom nobody says so, and as the
simulation that they are ("exact"), where nothing is to be chosen.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

import stereo_slam_env as sse
from changed_recordings import CHANGES, HEADS, RECORDINGS, Row, changed, measured_again, rendered, scored
from filters import ColouredNoise
from harness import arguments, show
from stereo_slam_env.frontend.track_noise import COMMON_WALK, COMMON_WALK_WITH_R, bring_R
from stereo_slam_env.recording.recording import GIVEN_TRUTH, Recording

GRID = (0.001, 0.0014, 0.002, 0.00275, 0.0035, COMMON_WALK, 0.0055)
"""Walks, rad per root of a radian."""


def by(walk: float, told: Recording) -> Recording:
    """A recording whose noise was measured, with another gauge walk."""
    assert isinstance(told.noise, ColouredNoise)
    return replace(told, noise=replace(told.noise, gauge_walk=walk))


def chosen(rows: Sequence[Mapping[float, Sequence[Row]]]) -> float:
    """The walk with the best mean log score: over the changes of a recording, then over recordings."""
    return min(rows[0], key=lambda walk: float(np.mean([_score(row[walk]) for row in rows])))


def _score(rows: Sequence[Row]) -> float:
    return float(np.mean([np.nanmean(row.scores) for row in rows]))


def drives_of(data: Path | None, seeds: range, renderers: Sequence[str], routes: Sequence[str]) -> Iterator[Recording]:
    """Real recordings, then rendered ones."""
    for name, frames in RECORDINGS.items():
        if data is not None and (data / name).is_dir():
            yield sse.load(data / name)[:frames]
    for route, renderer in product(routes, renderers) if seeds else ():
        for seed, drive in zip(seeds, rendered(seeds, renderer, route), strict=True):
            yield replace(drive, name=f"{route}, {renderer}, {seed}")


def main() -> None:
    """Run and print."""
    given = arguments(
        __doc__,
        "data?",
        data=Path,
        rendered=0,
        first_seed=300,
        renderers=["gl", "tiny"],
        routes=["right-turn", "town"],
    )
    rows: dict[bool, dict[str, dict[float, list[Row]]]] = {False: {}, True: {}}
    exact = []
    for drive in drives_of(
        given.data, range(given.first_seed, given.first_seed + given.rendered), given.renderers, given.routes
    ):
        simulated = drive.truth_from.kind == "simulation"
        if simulated:
            exact.append((drive.name, *scored(measured_again(drive)).cells))
        stranger = replace(drive, truth_from=GIVEN_TRUTH) if simulated else drive
        # A drive is as long as all others together where it is rendered: it is taken as it is.
        told = [changed(stranger, name) for name in (["as it is"] if simulated else CHANGES)]
        rows[bring_R(drive)][drive.name] = {walk: [scored(by(walk, one)) for one in told] for walk in GRID}
    for brings, found in rows.items():
        table, shipped = [], COMMON_WALK_WITH_R if brings else COMMON_WALK
        for name, of_this in found.items():
            others = [row for other, row in found.items() if other != name]
            if others:
                table.append((name, _mrad(chosen(others)), *of_this[chosen(others)][0].cells))
            table.append((f"{name}, as shipped", _mrad(shipped), *of_this[shipped][0].cells))
        if table:
            title = f"tracks {'with' if brings else 'without'} covariances; all choose "
            show(title + _mrad(chosen(list(found.values()))), ("left out", "mrad", *HEADS[1:]), table)
    if exact:
        show("rendered, as the simulation that it is", HEADS, exact)


def _mrad(walk: float) -> str:
    return f"{1e3 * walk:.2f}"


if __name__ == "__main__":
    main()
