"""Unit test of your own filter: at most 5 % worse than the paper's, consistent, fast.

The fixture `slam_bench` comes with the package (a pytest plug-in). It runs your filter and another one on the same
recordings, 8 s of pure geometry unless you say otherwise, and its assertions show the figures when they fail.

Run it: pytest examples/test_my_filter.py
or:     python examples/test_my_filter.py
"""

from typing import Any

from filters import StereoCamera, StereoEKF, StereoNoise


class MyFilter(StereoEKF):
    """Errors on SO(3) instead of the quaternion's; landmarks of a frame share their anchor."""

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        super().__init__(camera, noise, landmark="shared-anchor", error="so3", **options)


def test_my_filter(slam_bench: Any) -> None:
    """Takes a class or a name of `stereo-slam filters list`."""
    result = slam_bench(MyFilter, against="inverse-depth")
    result.assert_not_worse(percent=5)
    result.assert_consistent()
    result.assert_faster_than(ms=50)


if __name__ == "__main__":
    import stereo_slam_env as sse

    comparison = sse.compare(["inverse-depth", MyFilter], "reference-drive", seeds=5, frames=80)
    print(comparison.between("MyFilter", "inverse-depth"))
