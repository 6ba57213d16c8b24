"""Build by colcon (ament_python)."""

from setuptools import setup

setup(
    name="stereo_slam_node",
    version="0.1.0",
    packages=["stereo_slam_node"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/stereo_slam_node"]),
        ("share/stereo_slam_node", ["package.xml"]),
    ],
    install_requires=["setuptools", "stereo-slam-env"],
    entry_points={"console_scripts": ["stereo_slam = stereo_slam_node.node:main"]},
)
