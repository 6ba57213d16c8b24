"""Write a filter, check it, and compare it with the paper's.

A filter is any `StereoFilter`; this one composes parts of the engine: the pixels of both images in one update, errors
on SO(3), landmarks of a frame with a shared anchor. Put it into your own package and name it in
`[project.entry-points."stereo_slam.filters"]`, and `stereo-slam bench --filters inverse-depth,stacked` knows it.

Run it: python examples/write_a_filter.py
"""

from typing import Any

import stereo_slam_env as sse
from filters import StereoCamera, StereoEKF, StereoNoise, check_filter


class StackedEKF(StereoEKF):
    """The pixels of both images in one update, on SO(3), with shared anchors."""

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        super().__init__(camera, noise, landmark="shared-anchor", measurement="stacked", error="so3", **options)


if __name__ == "__main__":
    print(check_filter(StackedEKF))

    for moment in sse.run(StackedEKF, sse.make_recording("reference-turn", seed=0)):
        error, covariance = moment.pose_error
        print(f"{moment.time:.1f} s: position error {error[:3].round(4)} m, sigma {covariance.diagonal()[:3] ** 0.5}")
    print(sse.compare(["inverse-depth", StackedEKF], "reference-turn", seeds=6).between("StackedEKF", "inverse-depth"))
