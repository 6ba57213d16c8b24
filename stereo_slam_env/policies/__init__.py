"""Who decides where to look: simple rules, planning on a filter's belief, and a trained network, behind one interface."""

from stereo_slam_env.policies.interface import Policy
from stereo_slam_env.policies.registry import available_policies, make_policy

__all__ = ["Policy", "available_policies", "make_policy"]
