"""A stereo SLAM filter, found by stereo-slam-env through its entry point."""

from my_slam_filter.my_filter import MyFilter

__all__ = ["MyFilter"]
