"""The terms of the reward, one function each; an environment adds up those it names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step came to.

    Attributes
    ----------
    progress : float
        Along the route, m; negative backwards.
    tracked : float
        Landmarks in the frame as a share of the most there can be.
    failed : bool
        Whether the car hit something or left the arena.
    arrived : bool
        Whether it came to the end of the route without that.
    turned : (2,)
        How far pan and tilt moved, as a share of the most they can in a step.
    """

    progress: float = 0.0
    tracked: float = 0.0
    failed: bool = False
    arrived: bool = False
    turned: FloatArray | None = None


def progress(outcome: Outcome, weight: float) -> float:
    """So much for each metre along the route."""
    return weight * outcome.progress


def tracking(outcome: Outcome, weight: float) -> float:
    """So much for a frame full of landmarks: to stare at a wall is bad for SLAM."""
    return weight * outcome.tracked


def collision(outcome: Outcome, weight: float) -> float:
    """So much less for hitting something or leaving the arena."""
    return -weight if outcome.failed else 0.0


def goal(outcome: Outcome, weight: float) -> float:
    """So much for reaching the end of the route."""
    return weight if outcome.arrived else 0.0


def effort(outcome: Outcome, weight: float) -> float:
    """So much less for turning the head as fast as it can, by the mean square of both axes."""
    return 0.0 if outcome.turned is None else -weight * float(np.mean(outcome.turned**2))


TERMS = {"progress": progress, "tracking": tracking, "collision": collision, "goal": goal, "effort": effort}
"""Name -> term; its weight is the argument `<name>_weight` of the environment, its value `reward_<name>` in info."""
