"""Leaderboard of claims, from packets of results; `python -m stereo_slam_env.report.leaderboard RESULTS PAGE.md`.

Sorted by how far the claim is from the truth, not by the error: the factor of the scale gap, whichever way.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from filters.contract.foreign_text import markdown
from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.packets import read_packet
from stereo_slam_env.evaluation.figures import FIGURES, readable
from stereo_slam_env.files.folders import write_atomically

_HEADS = (
    *("system", "recordings", FIGURES["position_rmse_m"].title),
    *("NEES / 6", "k", "inside 90 %, %", "log score", "diverged"),
)
_UNKNOWN = "–"
_FEWEST = 5
"""Recordings from which on k has an interval."""


def leaderboard(packets: Mapping[str, Mapping[str, Any]]) -> str:
    """The page, in Markdown: a table for each packet, the cells of a grid in their order; keys are names of files."""
    return "\n".join([_HEAD, *(_section(name, packet) for name, packet in packets.items())])


def _section(name: str, packet: Mapping[str, Any]) -> str:
    """Heading, where it comes from, what is missing, and the table."""
    cells = packet["cells"]
    heads: tuple[str, ...] = _HEADS
    numbers = len(heads) - 1
    rows = []
    for cell in cells:
        found = sorted((_row(label, trials) for label, trials in cell["trials"].items()), key=lambda row: row[:2])
        rows += [columns if len(cells) == 1 else [markdown(cell["name"]), *columns] for _, _, columns in found]
    if len(cells) > 1:
        heads = ("cell", *heads)
    marks = "|---" * (len(heads) - numbers) + "|" + "--:|" * numbers
    table = "\n".join(["| " + " | ".join(heads) + " |", marks, *("| " + " | ".join(row) + " |" for row in rows)])
    return f"## {markdown(packet['study']['name'])}\n\n{_about(name, packet)}\n\n{table}\n"


def _about(name: str, packet: Mapping[str, Any]) -> str:
    """Where it comes from, and what is missing, in lines of Markdown."""
    cells = packet["cells"]
    kinds = sorted({markdown(str(one["reference"])) for cell in cells for one in cell["recordings"]})
    lines = [f"`stereo-slam verify results/{markdown(name)}` runs a part of it again. Truth: {', '.join(kinds)}."]
    said = map(markdown, packet["missing"])
    missing = [each if len(cells) > 1 else each.partition(": ")[2] for each in said]
    if missing:
        lines.append("\n".join(textwrap.wrap(f"Missing: {'; '.join(missing)}.", 100, break_on_hyphens=False)))
    return "\n\n".join(lines)


def _row(label: str, trials: Sequence[Mapping[str, Any]]) -> tuple[tuple[bool, float], str, list[str]]:
    """Place in the table (what diverged last, then by the distance of the claim from the truth), label and cells."""
    claims = [trial["claim"] for trial in trials if "claim" in trial]
    gaps = np.log([claim["scale_gap"] for claim in claims])
    gap = float(np.exp(np.mean(gaps))) if claims else None
    errors = [trial["position_rmse_m"] for trial in trials if trial["position_rmse_m"] is not None]
    nees = [trial["pose_anees"] / 6.0 for trial in trials if trial["pose_anees"] is not None]
    cells = [
        markdown(label),
        str(len(trials)),
        readable(np.sqrt(np.mean(np.square(errors)))) if errors else _UNKNOWN,
        _short(np.mean(nees)) if nees else _UNKNOWN,
        _UNKNOWN if gap is None else _short(gap) + _interval(gaps),
        f"{100.0 * np.mean([claim['coverage_90'] for claim in claims]):.0f}" if claims else _UNKNOWN,
        _short(np.mean([claim["log_score"] for claim in claims])) if claims else _UNKNOWN,
        str(sum(bool(trial["diverged"]) for trial in trials)),
    ]
    diverged = any(trial["diverged"] for trial in trials)
    return (diverged, np.inf if gap is None else abs(float(np.log(gap)))), label, cells


def _interval(logarithms: FloatArray) -> str:
    """95 % interval of a geometric mean, of recordings enough for one."""
    count = len(logarithms)
    if count < _FEWEST:
        return ""
    middle, half = np.mean(logarithms), t.ppf(0.975, count - 1) * np.std(logarithms, ddof=1) / np.sqrt(count)
    return f" ({_short(np.exp(middle - half))} to {_short(np.exp(middle + half))})"


def _short(value: Any) -> str:
    """Two decimals, or two digits of what is far too large to read."""
    return f"{value:.2f}" if abs(value) < 1000.0 else readable(value, ".2g")


_HEAD = """# Leaderboard of claims

Made from the packets in [`results/`](../results) by
`python -m stereo_slam_env.report.leaderboard results docs/leaderboard.md`. The first system of a
table is the one whose covariances are nearest to its errors, by k, the median NEES over its ideal:
1 is right, 4 says that deviations are claimed half as large as they are. Systems that diverged in
any recording come last. k, coverage and log score are of the first ten recordings, in the world of
the recording, not aligned; [how results are handed in](handing_in.md) and what each figure
[means](evaluate.md#what-is-said). From five recordings on k has its 95 % interval. From drive to
drive it changes by a factor of 1.3 to 1.4, even of a filter whose models hold (`limits`, `quick`):
where intervals overlap, or there is none, neighbours in a table are not told apart.
"""


def read_results(folder: Path) -> dict[str, dict[str, Any]]:
    """All packets of a folder, by name of the file; raises as `read_packet`."""
    return {path.name: read_packet(path) for path in sorted(folder.glob("*.json"))}


if __name__ == "__main__":
    page = leaderboard(read_results(Path(sys.argv[1])))
    write_atomically(Path(sys.argv[2]), lambda stream: stream.write(page.encode()))
