"""All pictures of the manual, drawn afresh.

    python docs/images/make.py                    # all of them
    python docs/images/make.py report.png view.png
    python docs/images/make.py --but view_rerun.jpg
    python docs/images/make.py --small --out /tmp/pictures      # short runs, to see that each can be drawn

Needs the extras dev, gl, rl and viewer, and a browser (apt install chromium) for `report.png` and `view_rerun.jpg`; a
picture that cannot be drawn here is named at the end and stays as it was.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import pictures_of_concepts as concepts
import pictures_of_drives as drives
import pictures_of_inertial as inertial
import pictures_of_runs as runs

HERE = Path(__file__).resolve().parent
REPEATABLE: Mapping[str, Callable[[Path], None]] = {
    **{f"concept_{draw.__name__}.svg": partial(concepts.save, draw) for draw in concepts.FIGURES},
    "blank.jpg": drives.blank,
    "gaze.jpg": drives.gaze,
    "groves.jpg": drives.groves,
    "scenes.jpg": drives.scenes,
    "search.jpg": drives.search,
    "view.png": drives.view,
}
"""Pictures that are the same whenever they are drawn."""
OF_RUNS: Mapping[str, Callable[..., None]] = {
    "bodies.webp": runs.bodies,
    "drive.webp": runs.drive,
    "report.png": runs.report,
    "view_rerun.jpg": runs.rerun,
    "paper_cloud.png": runs.paper_cloud,
    "paper_depth.png": runs.paper_depth,
    "inertial_nees.png": inertial.nees,
    "inertial_worth.png": inertial.worth,
}
"""Pictures of runs that measure time, take long, or are drawn by another program."""
PICTURES = [*REPEATABLE, *OF_RUNS]


def draw(name: str, path: Path, *, small: bool = False) -> None:
    """Draw one picture; the file appears when it is complete."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        drawn = work / name
        if name in REPEATABLE:
            REPEATABLE[name](drawn)
        else:
            OF_RUNS[name](drawn, work, small=small)
        path.write_bytes(drawn.read_bytes())


def main() -> int:
    """Draw what was asked for; the number of pictures that could not be drawn."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="which pictures; all unless said")
    parser.add_argument("--but", nargs="+", default=[], metavar="NAME", help="all but these")
    parser.add_argument("--out", type=Path, default=HERE, help="the folder; that of the manual unless said")
    parser.add_argument("--small", action="store_true", help="short runs, to see that each can be drawn")
    given = parser.parse_args()
    if unknown := [name for name in (*given.names, *given.but) if name not in PICTURES]:
        parser.error(f"no picture {unknown[0]}: there are {', '.join(PICTURES)}")
    if given.small and given.out.resolve() == HERE:
        parser.error("--small needs another folder, --out FOLDER: its pictures are none of the manual")
    given.out.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in given.names or PICTURES:
        if name in given.but:
            continue
        begun = time.perf_counter()
        try:
            draw(name, given.out / name, small=given.small)
        except (ImportError, runs.NoBrowser) as error:
            failed.append(f"{name} was not drawn: {error}")
            continue
        sys.stdout.write(f"{name}: {time.perf_counter() - begun:.0f} s\n")
        sys.stdout.flush()
    sys.stdout.writelines(f"{line}\n" for line in failed)
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
