"""Who decides where to look: rules, planning on the belief of a filter, and a trained network; one interface."""

from stereo_slam_env.policies.interface import Policy
from stereo_slam_env.policies.registry import available_policies, make_policy

__all__ = ["Policy", "available_policies", "make_policy"]
