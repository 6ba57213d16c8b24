"""`StereoSlam/Branches-v0`: decide at each junction where to drive, to a new road or to one that is known."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces

from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import PaidRows
from stereo_slam_env.envs.rows import Arrays, Rows, Seeds, Step
from stereo_slam_env.envs.task_env import TaskEnv
from stereo_slam_env.simulator.state import WEIGHTS
from stereo_slam_env.world.routes import through_streets
from stereo_slam_env.world.street_grid import BACK, LEFT, RIGHT, STRAIGHT, Place, StreetGrid

EXISTS, DRIVEN, TO_NEW, TO_START, SIGMA = range(5)
"""Columns of the key `branches`."""
_MOST = np.array([1.0, 1.0, 60.0, 60.0, 100.0], dtype=np.float32)
"""Of each column."""
_MOST_ROADS = 1000.0


class BranchChoice(PaidRows):
    """The agent chooses at each junction which road is driven, and is paid for a map that is true.

    The action is `Discrete(3)`: left, straight on, right; where there is no such road, the first that exists of
    straight on, right, left is taken, and at a dead end the car turns round. A script drives the road to its middle,
    where the next choice is made; the episode ends after `roads` choices. A landmark of the filter's map counts
    1 - (true error / `accuracy`)^2, not less than 0; the share of the map is the sum of that over the number of all
    landmarks that stand along so many roads. The reward of a choice is `weight` times what that share has gained: by
    new landmarks, by a loop that is closed, which puts right where all others are, or less than 0 by an estimate that
    goes astray.

    The observation gains `branches` (3, 5), for left, straight on and right: whether there is such a road, whether it
    has been driven, how many roads further on the nearest is that has not been driven, and that of the start, and the
    claimed standard deviation of the position there when it was first driven, m, or now where it has not been;
    `roads_left` (1,); and `mapped` (1,), the share of the map that the filter claims, by its variances instead of
    squared errors. `info` gains `mapped`, the true share, `roads`, how many different ones have been driven, and
    `reward_map`; `is_success` is whether the true share has reached `goal` without a collision.

    Parameters
    ----------
    env : gymnasium.Env
        A scripted drive on the route "random-grid", with `BeliefObservation` around it.
    roads : int
        Choices in an episode.
    accuracy : float
        m.
    weight : float
        Paid for the whole map.
    goal : float
        Share of the map, above 0.

    Raises
    ------
    ValueError
        An argument is impossible, or the route does not lead through streets.
    """

    def __init__(
        self,
        env: Any,
        roads: int = 12,
        accuracy: float = 1.0,
        weight: float = 100.0,
        goal: float = 0.25,
    ) -> None:
        super().__init__(env, ["map"])
        self._beliefs: FilterRows = self.needed("beliefs")
        streets_of(env)  # refused before the first episode
        self._roads, self._accuracy = whole_number("roads", roads, 1, int(_MOST_ROADS)), positive("accuracy", accuracy)
        self._weight, self._goal = positive("weight", weight), positive("goal", goal)
        self._still = np.zeros((self.num_envs, *env.action_space.shape), dtype=np.float32)
        added = {
            "branches": spaces.Box(0.0, np.tile(_MOST, (3, 1))),
            "roads_left": spaces.Box(0.0, _MOST_ROADS, (1,), np.float32),
            "mapped": spaces.Box(0.0, 1.0, (1,), np.float32),
        }
        self.observation_space = spaces.Dict({**self.dict_space(), **added})
        self.action_space = spaces.Discrete(3)
        self._places: list[Place | None] = [None] * self.num_envs
        self._choices: list[list[int]] = [[] for _ in range(self.num_envs)]
        self._driven: list[BoolArray] = [np.zeros(0, dtype=np.bool_)] * self.num_envs
        self._sigmas: list[FloatArray] = [np.zeros(0)] * self.num_envs
        """Of each road the claimed position sigma when it was first driven, m."""
        self._credit, self._claimed = np.zeros((2, self.num_envs))
        """Share of the map, by the truth and as the filter claims it."""

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """The car stands in the middle of its first road."""
        super().reset(chosen, seeds, options)
        for b in np.flatnonzero(chosen).tolist():
            streets = self._streets(b)
            self._choices[b] = []
            self._driven[b], self._sigmas[b] = np.zeros(streets.count, dtype=np.bool_), np.zeros(streets.count)
            self._arrive(b, streets.start)
        self._map(chosen)

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Drive on to the middle of the road that is chosen."""
        goals, failed = np.zeros(self.num_envs, dtype=np.int64), np.zeros(self.num_envs, dtype=np.bool_)
        places: dict[int, Place] = {}
        for b in np.flatnonzero(going).tolist():
            place, streets = self._places[b], self._streets(b)
            assert place is not None
            choice, places[b] = streets.taken(place, int(actions[b]))
            self._choices[b].append(choice)
            route = through_streets(streets, self._choices[b])
            self.world.reroute(b, route)
            goals[b] = route.frames - 2  # of the step beyond it, which no row drives
        while (driving := going & ~failed & (self._steps < goals)).any():
            _, terminated, truncated = self.rows.step(self._still, driving)
            failed |= terminated | truncated
        for b in np.flatnonzero(going).tolist():
            self._arrive(b, places[b])
        before = self._credit.copy()
        self._map(going)
        over = going & (failed | (self._left == 0))
        return (
            self.paid(going, {"map": self._weight * (self._credit - before)}),
            over,
            np.zeros(self.num_envs, dtype=np.bool_),
        )

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = super().observe()
        credit, roads = self._credit.copy(), np.array([int(driven.sum()) for driven in self._driven])
        added = {"branches": np.stack([self._ahead(b) for b in range(self.num_envs)])}
        columns = {"roads_left": self._left, "mapped": self._claimed}
        added |= {key: values[:, None].astype(np.float32) for key, values in columns.items()}
        extras = {"mapped": credit, "roads": roads}
        success = (credit >= self._goal) & ~np.asarray(info["failed"])
        return {**observation, **added}, {**info, **extras, "is_success": success}

    @property
    def _steps(self) -> Any:
        """Numbers of the frames, (B,)."""
        return self._beliefs.frames

    @property
    def _left(self) -> Any:
        """Roads that may still be driven, (B,)."""
        return self._roads - np.array([len(choices) for choices in self._choices])

    def _streets(self, b: int) -> StreetGrid:
        streets = self.world.route_of(b).streets
        assert streets is not None
        return streets

    def _arrive(self, b: int, place: Place) -> None:
        """The car is in the middle of a road."""
        road = self._streets(b).road(place)
        self._places[b] = place
        if not self._driven[b][road]:
            self._driven[b][road], self._sigmas[b][road] = True, self._sigma(b)

    def _sigma(self, b: int) -> float:
        """Claimed position sigma, m."""
        return float(np.sqrt(np.trace(self._beliefs.pose_covariances[b, :3, :3])))

    def _ahead(self, b: int) -> FloatArray:
        """Knowledge of the roads to the left, straight on and to the right, (3, 5)."""
        place, streets, driven = self._places[b], self._streets(b), self._driven[b]
        assert place is not None
        branch_features, start = np.zeros((3, len(_MOST)), dtype=np.float32), np.zeros(streets.count, dtype=np.bool_)
        start[streets.road(streets.start)] = True
        for choice, beyond in streets.ways(place).items():
            if choice != BACK:
                road = streets.road(beyond)
                sigma = self._sigmas[b][road] if driven[road] else self._sigma(b)
                ways = streets.roads_to(beyond, ~driven), streets.roads_to(beyond, start)
                branch_features[choice] = 1.0, driven[road], *ways, sigma
        clipped: FloatArray = np.minimum(branch_features, _MOST)
        return clipped

    def _map(self, which: BoolArray) -> None:
        """Look at the maps of some rows: the share of all landmarks that is where it is, by the truth and claimed."""
        maps = self._beliefs.world_maps()
        sigmas = np.sqrt(np.einsum("nii->n", maps.covariances))
        for b in np.flatnonzero(which).tolist():
            mine, truth = slice(*maps.offsets[b : b + 2]), self.world.landmark_truth(b).positions
            standing = maps.ids[mine] < len(truth)  # the others are on moving bodies
            errors = np.linalg.norm(maps.positions[mine][standing] - truth[maps.ids[mine][standing]], axis=1)
            most = len(truth) * min(self._roads / self._streets(b).count, 1.0)
            for share, each in ((self._credit, errors), (self._claimed, sigmas[mine][standing])):
                share[b] = np.maximum(1.0 - (each / self._accuracy) ** 2, 0.0).sum() / most


def streets_of(rows: Rows) -> StreetGrid:
    """The streets of the typical route of rows; a `ValueError` where it leads through none."""
    route = rows.get_attr("route")
    if route.streets is None:
        raise ValueError(f"the route must lead through streets, as 'random-grid' does, and {route.name!r} does not")
    streets: StreetGrid = route.streets
    return streets


class Branches(TaskEnv):
    """Drive through a grid of streets so that much of it is on the map, and true.

    ## Description

    The grid is drawn for each episode: 3 to 6 by 3 to 6 junctions, roads of 38 to 54 m, up to 30 % of them missing, so
    that some streets are dead ends, and the start on any of them. Groves stand along the roads, in fog. A script drives
    to the middle of the road that is chosen, some nine seconds, with a SLAM filter running; then the next one is
    chosen, twelve in all. New roads bring landmarks, but the farther from known ones the car is, the less true is their
    place; a closed loop puts them right, and costs roads that bring nothing new. World, sensors and truth are those of
    `StereoSlam/Drive-v0` with `policy="route"`, 16 landmarks at most and a visibility of 30 m.

    ![Six grids, by a drive through all of their roads](../images/concept_grids.svg)

    ## Action Space

    `Discrete(3)`: left, straight on, right. Where there is no such road, the first that exists of straight on, right,
    left is taken; at a dead end the car turns round.

    ## Observation Space

    `Dict`, nothing of it made from the truth:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `belief_sigmas` | (6,) | float32 | standard deviations of the pose: position in W, m; rotation, rad |
    | `branches` | (3, 5) | float32 | of the roads to the left, ahead and to the right, see below |
    | `roads_left` | (1,) | float32 | choices that are left |
    | `mapped` | (1,) | float32 | share of the map by the filter's own variances |

    A row of `branches`: whether there is such a road; whether it has been driven; how many roads further on the nearest
    new one is, and the start; the claimed standard deviation of the position there when it was first driven, or now, m.

    ## Rewards

    *reward_map*: 100 times what the share of the map has gained, by the truth. A landmark on the filter's map counts
    1 - (true error / 1 m)^2, not less than 0; the share is the sum of that over the number of landmarks that stand
    along twelve roads, or along all, if there are fewer. It may be negative: the filter has lost its way.

    ## Episode End

    Termination: after `roads` choices; `info["is_success"]` is whether a share of `goal` (0.25) has been reached
    without a collision. `info` has `mapped`, the true share, and `roads`, how many different ones have been driven.

    ## Arguments

    `roads` (12), `accuracy` (1 m), `weight` (100), `goal` (0.25) of `BranchChoice`; `filter`, `filter_options`, of
    which one that drops what is out of view has no map, `level`, `keys`, `observation`, `arguments`, and those of
    `StereoSlam/Drive-v0`.

    ## Training

    `stereo-slam train --environment StereoSlam/Branches-v0`. What blind lists of turns, rules, networks and an oracle
    score is on the page of the tasks.

    ## Version History

    * v0: first version.
    """

    world = "StereoSlam/Drive-v0"
    settings = MappingProxyType(
        {
            **{"route": "random-grid", "policy": "route", "surroundings": "groves", "visibility": 30.0, "rig": "vga"},
            **{"max_landmarks": 16, "revisit": True},
            **dict.fromkeys((f"{name}_weight" for name in WEIGHTS if name != "effort"), 0.0),
        }
    )
    parts = ((BranchChoice, {}),)
    keys = ("belief_sigmas", "branches", "roads_left", "mapped")


branches_vector = Branches.vector


def explore_and_close(observation: Mapping[str, Any]) -> int:
    """A rule: to the nearest new road; of those that are as near, to that from which the start is nearer.

    So new roads lead round blocks, and loops are closed.
    """
    return _nearest(observation, [TO_NEW, TO_START])


def to_new_roads(observation: Mapping[str, Any]) -> int:
    """A rule that closes no loop on purpose: to the nearest new road, straight on where that is as near."""
    return _nearest(observation, [TO_NEW])


def _nearest(observation: Mapping[str, Any], by: list[int]) -> int:
    """The road that is the nearest by columns of `branches`; of equal ones straight on, then right."""
    branch_rows = np.asarray(observation["branches"])
    existing = [choice for choice in (STRAIGHT, RIGHT, LEFT) if branch_rows[choice, EXISTS]] or [STRAIGHT]
    return min(existing, key=lambda choice: tuple(branch_rows[choice, by]))
