"""The size of the gauge walk, chosen on all recordings but one and judged on that one.

    python benchmarks/left_out.py DATA                            # some minutes
    python benchmarks/left_out.py --rendered 2 --routes right-turn

Two constants of `stereo_slam_env/frontend/track_noise.py` size it: what lens and calibration add to all tracks of a
frame (`COMMON_FLOOR`), and the share of the slide that they have in common (`SLIDE_IN_COMMON`). For each recording
those values are taken that give the others the best mean log score of windows of 1 s and 10 s. NEES/6 of the pose and
of windows on the one that was left out should be 1. Vision only.

Rendered drives have an exact lens, rig and truth. They are judged as the simulation that they are ("exact"), and as a
stranger's, to whom nobody says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

import stereo_slam_env as sse
from changed_recordings import HEADS, RECORDINGS, Row, measured_again, rendered, scored
from filters import ColouredNoise
from harness import arguments, show
from stereo_slam_env.frontend.track_noise import COMMON_FLOOR, SLIDE_IN_COMMON
from stereo_slam_env.recording.recording import GIVEN_TRUTH, Recording

GRID = tuple(product((0.0014, 0.002, 0.00275, 0.004, 0.0055), (0.0, 0.25, 0.5)))
"""Values of both, rad per root of a radian, and the share."""
SHIPPED = (COMMON_FLOOR, SLIDE_IN_COMMON)

Constants = tuple[float, float]


def by(constants: Constants, told: Recording) -> Recording:
    """A recording that was told its noise by the shipped constants, as others would have told it."""
    noise = told.noise
    assert isinstance(noise, ColouredNoise)
    slide = np.sqrt(max(noise.gauge_walk**2 - COMMON_FLOOR**2, 0.0)) / SLIDE_IN_COMMON
    return replace(told, noise=replace(noise, gauge_walk=float(np.hypot(constants[0], constants[1] * slide))))


def chosen(rows: Sequence[Mapping[Constants, Row]]) -> Constants:
    """The constants with the best mean log score over some recordings."""
    return min(rows[0], key=lambda c: float(np.mean([np.nanmean(row[c].scores) for row in rows])))


def show_left_out(data: Path) -> None:
    """A row for each recording by the constants of the others, and as shipped."""
    there = {name: frames for name, frames in RECORDINGS.items() if (data / name).is_dir()}
    drives = {name: measured_again(sse.load(data / name)[:frames]) for name, frames in there.items()}
    rows = {name: {c: scored(by(c, drive)) for c in GRID} for name, drive in drives.items()}
    table = []
    for name, of_this in rows.items():
        best = chosen([row for other, row in rows.items() if other != name])
        table.append((name, _said(best), *of_this[best].cells))
        table.append(("  as shipped", _said(SHIPPED), *of_this[SHIPPED].cells))
    title = f"left out; all together choose {_said(chosen(list(rows.values())))}"
    show(title, ("", "mrad, share", *HEADS[1:]), table)


def _said(constants: Constants) -> str:
    return f"{1e3 * constants[0]:.2f}, {constants[1]:.2f}"


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
    if given.data is not None:
        show_left_out(given.data)
    table = []
    seeds = range(given.first_seed, given.first_seed + given.rendered)
    for route, renderer in product(given.routes, given.renderers) if given.rendered else ():
        for seed, drive in zip(seeds, rendered(seeds, renderer, route), strict=True):
            table.append((f"{route}, {renderer}, {seed}, exact", *scored(measured_again(drive)).cells))
            stranger = measured_again(replace(drive, truth_from=GIVEN_TRUTH))
            table.append(("  a stranger's", *scored(stranger).cells))
    if table:
        show("rendered", HEADS, table)


if __name__ == "__main__":
    main()
