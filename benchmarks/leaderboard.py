"""Leaderboard of claims, from packets of results: writes `docs/leaderboard.md`.

    python benchmarks/leaderboard.py results/quick.json results/reference-turn.json results/limits.json

Only systems with ten recordings or more have a row: k of fewer says little. Rows are sorted by how far the claim is
from the truth, not by the error; what diverged comes last.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.stats import t

from filters.contract.validation import markdown
from stereo_slam_env.benchmark.packets import read_packet
from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.files import write_text

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "leaderboard.md"
PACKETS = [ROOT / "results" / f"{name}.json" for name in ("quick", "reference-turn", "limits")]
FEWEST = 10
"""Recordings of a row."""
HEAD = """# Leaderboard of claims

Made by `python benchmarks/leaderboard.py` from packets in [`results/`](../results), of which
`stereo-slam verify results/quick.json` runs a part again. The first system of a drive is the one
whose covariances are nearest to its errors by k, the median NEES over its ideal: 1 is right, 4 says
that deviations are claimed half as large as they are. k, with its 95 % interval, and the share
inside 90 % are of the first ten recordings, in the world of the recording, not aligned. Where
intervals overlap, systems are not told apart. Hand in yours by [a packet](handing_in.md) of ten
recordings or more; what each figure [means](evaluate.md#what-is-said).

| drive | system | recordings | position error, m | NEES / 6 | k | inside 90 %, % | diverged |
|---|---|--:|--:|--:|--:|--:|--:|
"""


def leaderboard(packets):
    """The page, in Markdown."""
    return HEAD + "".join(f"| {' | '.join(row)} |\n" for packet in packets for row in rows(packet))


def rows(packet):
    """Cells of the table, the nearest claim first, in each cell of a study."""
    for cell in packet["cells"]:
        systems = [row(label, trials) for label, trials in cell["trials"].items() if len(trials) >= FEWEST]
        for _, columns in sorted(systems):
            yield [markdown(cell["name"]), *columns]


def row(label, trials):
    """Place in the table (diverged, distance of the claim from the truth), and its cells."""
    claims = [trial["claim"] for trial in trials if "claim" in trial]
    errors = [trial["position_rmse_m"] for trial in trials if trial["position_rmse_m"] is not None]
    nees = [trial["pose_anees"] / 6.0 for trial in trials if trial["pose_anees"] is not None]
    gaps = np.log([claim["scale_gap"] for claim in claims])
    diverged = sum(bool(trial["diverged"]) for trial in trials)
    cells = [
        markdown(label),
        str(len(trials)),
        readable(np.sqrt(np.mean(np.square(errors)))) if errors else "–",
        f"{np.mean(nees):.2f}" if nees else "–",
        interval(gaps) if claims else "–",
        f"{100.0 * np.mean([claim['coverage_90'] for claim in claims]):.0f}" if claims else "–",
        str(diverged),
    ]
    return (diverged > 0, abs(np.mean(gaps)) if claims else np.inf), cells


def interval(logarithms):
    """Geometric mean with its 95 % interval."""
    middle, half = np.mean(logarithms), 0.0
    if len(logarithms) > 1:
        half = t.ppf(0.975, len(logarithms) - 1) * np.std(logarithms, ddof=1) / np.sqrt(len(logarithms))
    return f"{np.exp(middle):.2f} ({np.exp(middle - half):.2f} to {np.exp(middle + half):.2f})"


def main():
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packets", nargs="*", type=Path, default=PACKETS, help="what `stereo-slam submit` wrote")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    write_text(options.out, leaderboard(map(read_packet, options.packets)))


if __name__ == "__main__":
    main()
