"""Charts saved as pictures; many are drawn in processes, as the drawing of Vega has one thread in each.

The processes start from nothing; this one, which may have threads, is not forked.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from stereo_slam_env.report.charts.drawing import Chart

Picture = tuple[Chart, tuple[Path, ...]]
"""A chart, and the files that it is drawn into."""
FEWEST = 4
"""Charts for which another process is worth its start."""
MOST_PROCESSES = 4
SECONDS = 300.0
"""After so long a process that draws is given up."""


def save_all(pictures: Sequence[Picture]) -> list[str]:
    """Draw every chart into its files; returns the drawings, as `Chart.save` does.

    Those of a process that fails are drawn here, so that what is wrong with a chart is told as ever.
    """
    count = max(1, min(_cores(), MOST_PROCESSES, len(pictures) // FEWEST))
    shares = [range(first, len(pictures), count) for first in range(count)]
    drawings: dict[int, str] = {}
    with ExitStack() as stack:
        others_drawn = [stack.enter_context(_elsewhere([pictures[i] for i in share])) for share in shares[1:]]
        drawings |= {i: _saved(pictures[i]) for i in shares[0]}
        for share, drawn in zip(shares[1:], others_drawn, strict=True):
            found = drawn() or [_saved(pictures[i]) for i in share]
            drawings |= dict(zip(share, found, strict=True))
    return [drawings[i] for i in range(len(pictures))]


def _saved(picture: Picture) -> str:
    chart, paths = picture
    return chart.save(*paths)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _elsewhere(share: Sequence[Picture]) -> Iterator[Callable[[], list[str] | None]]:
    """A function that waits for the drawings of a process, None where it fails; it ends with the block."""
    specs = [[chart.spec, [str(path.resolve()) for path in paths]] for chart, paths in share]
    code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import draw_share; draw_share()"
    with tempfile.TemporaryFile() as request, tempfile.TemporaryFile() as drawn:
        request.write(json.dumps(specs).encode())
        request.seek(0)
        process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=request, stdout=drawn, stderr=subprocess.DEVNULL, start_new_session=True
        )

        def wait() -> list[str] | None:
            try:
                if process.wait(SECONDS) != 0:
                    return None
            except subprocess.TimeoutExpired:
                return None
            drawn.seek(0)
            drawings: list[str] = json.loads(drawn.read())
            return drawings

        try:
            yield wait
        finally:
            process.kill()
            process.wait()


def draw_share() -> None:
    """Draw what the standard input says, and write the drawings as JSON."""
    pictures = json.loads(sys.stdin.read())
    json.dump([Chart(spec).save(*map(Path, paths)) for spec, paths in pictures], sys.stdout)
