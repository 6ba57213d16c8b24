"""Stereo SLAM as a ROS 2 node."""
