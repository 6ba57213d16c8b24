"""The limits that the decision rule is applied with: chosen before these runs, each with its reason."""

from __future__ import annotations

from stereo_slam_env.studies.paper.claims import Range

RELEVANT = 0.02
"""A difference between two filters below 2 % is none: nobody would choose between them by it."""

BETTER = Range(high=1.0 / (1.0 + RELEVANT))
"""Of the ratio of the paper's filter to its rival, for anything of which less is better."""

REGION = Range(0.94, 0.96)
"""Share of the true cloud in a region that is meant to hold 95 %: right to one percentage point."""
NOT_REGION = Range(high=0.94)
"""The same of a region that does not enclose the cloud."""

SIGMA_RIGHT_TO = 0.10
"""A filter is consistent if the standard deviations that it claims are right to 10 %."""
CONSISTENT = Range((1.0 + SIGMA_RIGHT_TO) ** -2, (1.0 + SIGMA_RIGHT_TO) ** 2)
"""Of NEES by its degrees of freedom: the ratio of the true variance to the claimed one."""
INCONSISTENT = Range(low=(1.0 + SIGMA_RIGHT_TO) ** 2)
"""The same of a filter that is surer than it may be."""

POSITION_M = Range(high=2.0)
"""The paper grants its own ground truth errors of up to two metres (4.4): nothing better could be seen there."""
YAW_DEG = Range(high=1.0)
"""A hundredth of the paper's turns, which is about what its figure 6 can show."""
VELOCITY_M_S = Range(high=0.25)
"""5 % of the car's speed, which is about what the paper's figure 6 can show."""
SCALE_PERCENT = Range(high=1.0)
""""A little" scale drift: the scale at the end within 1 % of that at the start."""
DRIFT_PERCENT = Range(high=1.0)
""""Minor" drift: 1 % of the way, what good stereo odometry of that time had on KITTI."""
