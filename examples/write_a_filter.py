"""Write a filter, check it, and compare it with the paper's.

A filter is any `StereoFilter`; this one composes parts of the engine: the pixels of both images in one update, errors
on SO(3), landmarks of a frame with a shared anchor. Put it into your own package and name it in
`[project.entry-points."stereo_slam.filters"]`, and `stereo-slam bench --filters inverse-depth,stacked` knows it.

Run it: python examples/write_a_filter.py
"""

from typing import Any

from filters import StereoCamera, StereoEKF, StereoNoise, check_filter
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn


class StackedEKF(StereoEKF):
    """The pixels of both images in one update, on SO(3), with shared anchors."""

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        super().__init__(camera, noise, landmark="shared-anchor", measurement="stacked", error="so3", **options)


if __name__ == "__main__":
    print(check_filter(StackedEKF))

    recording = short_turn(seed=0)
    slam = StackedEKF(recording.camera, recording.noise)
    start = recording.start
    slam.reset(start)
    for k, frame in enumerate(recording.frames):
        if k > 0:
            slam.predict(frame.timestamp - recording.frames[k - 1].timestamp)
        slam.update(frame.observation)
    error, covariance = slam.pose_error(frame.truth.position, frame.truth.orientation)
    print("position error after 12 frames:", error[:3].round(4), "m; claimed sigma:", covariance.diagonal()[:3] ** 0.5)
