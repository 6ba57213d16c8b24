"""Filters of stereo-slam-env as a baseline of VSLAM-LAB (its interface 2.1): belongs into its folder Baselines."""

from __future__ import annotations

from Baselines.BaselineVSLAMLAB import BaselineVSLAMLAB


class STEREOSLAM_baseline(BaselineVSLAMLAB):
    """EKF-SLAM on stereo pairs; the parameter `filter` names which one."""

    def __init__(self, baseline_name: str = "stereoslam", baseline_folder: str = "stereo-slam-env") -> None:
        super().__init__(baseline_name, baseline_folder, {"verbose": 1, "mode": "stereo", "filter": "coloured-noise"})
        self.color = (0.2, 0.45, 0.7)
        self.modes = ["stereo"]
        self.cam_models = ["pinhole", "radtan4", "radtan5", "equid4"]
        self.command_style = "python"

    def has_source(self) -> bool:
        """Nothing is cloned: it is a package of the environment."""
        return True

    def is_installed(self) -> tuple[bool, str]:
        """With the environment."""
        return True, "is installed"
