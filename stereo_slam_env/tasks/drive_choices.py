"""`DriveChoices`: the action is the number of a choice that holds for a second, and a script steers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import BoolArray
from stereo_slam_env.envs.rows import Rows, RowsWrapper, Step
from stereo_slam_env.policies.rows import follow_route
from stereo_slam_env.wrappers.row_wrapper import RowWrapper


class DriveChoicesRows(RowsWrapper):
    """What `DriveChoices` does, on rows; see there."""

    def __init__(self, rows: Rows, speeds: Sequence[float], pans: Sequence[float], hold: int, stop: int) -> None:
        super().__init__(rows)
        self._hold, self._stop = whole_number("hold", hold, 1), whole_number("stop", stop, 2)
        pairs = [(positive("speeds", speed), pan) for speed in speeds for pan in pans]
        self._speeds, pan = np.array([(0.0, 0.0), *pairs]).T
        try:
            self._route = rows.inner("route_shown")  # by an estimate
        except AttributeError:
            self._route = partial(self.world.shown, "route")
        self._entries: int = rows.action_space.shape[0]
        self._pans = np.zeros((len(pan), self._entries), dtype=np.float32)
        self._pans[:, -2], self._pans[0, stop] = pan, 1.0
        self.action_space = spaces.Discrete(len(pan))

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; drive as was chosen until the choice ends, or the episode."""
        chosen = np.asarray(actions)
        total, over, late, still = np.zeros(self.count), ~going, np.zeros_like(going), going
        for _ in range(self._hold):
            seen = {"car": self.world.shown("car"), "route": self._route()}
            driven = follow_route(seen, self._entries, speed=self._speeds[chosen])
            rewards, ended, cut = self.rows.advance(driven + self._pans[chosen], still)
            total, over, late = total + rewards, over | ended | cut, late | cut
            still = going & ~over
            if not still.any():
                break
        return total, going & over & ~late, late


class DriveChoices(RowWrapper):
    """An agent that chooses a speed and a direction of gaze every second, or stops; `follow_route` steers.

    The action is `Discrete(1 + S P)`: 0 stops, 1 + P s + p is the speed number s and the gaze number p. So what is to
    be learnt is where to look, how fast to drive, and when to stop, and not how to keep a lane; a return is that of the
    environment inside.

    Parameters
    ----------
    env : gymnasium.Env
        In which the agent drives and turns its head, and an entry of the action stops.
    speeds : (S,) sequence of float
        Largest speed, m/s.
    pans : (P,) sequence of float
        Shares of the largest pan, positive to the right.
    hold : int
        Steps for which a choice holds.
    stop : int
        Entry of the action that stops if it is 1.
    """

    OnRows = DriveChoicesRows

    def __init__(
        self,
        env: gym.Env[Any, Any],
        speeds: Sequence[float] = (5.0, 8.0),
        pans: Sequence[float] = (-0.7, 0.0, 0.7),
        hold: int = 10,
        stop: int = 2,
    ) -> None:
        super().__init__(env)
