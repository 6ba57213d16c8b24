"""Compare filters, one of them your own, on the same drives, with a test of significance.

Each seed is a drive; all filters get the same bits, and differences are taken drive by drive. The command
`stereo-slam bench` does this with more scenarios and a report. Run it: python examples/compare_filters.py --seeds 8
"""

import argparse

import stereo_slam_env as sse
from filters import StereoEKF


class Stacked(StereoEKF):
    """A filter of your own: any class that `make_filter` can make."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, noise, landmark="shared-anchor", measurement="stacked", error="so3", **options)


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--seeds", type=int, default=8)
parser.add_argument("--frames", type=int, default=80)
given = parser.parse_args()

comparison = sse.compare(
    ["inverse-depth", "euclidean", Stacked],
    "reference-drive",
    seeds=given.seeds,
    frames=given.frames,
)
print(comparison)
for label in ("euclidean", "Stacked"):
    print(comparison.between(label, "inverse-depth"))
