"""Compiled code that a recipe needs, and no more: its units and the functions of its parts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from filters.kernels.calls import Calls, Unit, addresses, of_part
from filters.kernels.correction import correct
from filters.kernels.covariance import scale_blocks, shear
from filters.kernels.frame import compile_frame, drop_unseen, may_change
from filters.kernels.gating import largest_agreement, squared_distances
from filters.kernels.gauge_walk import walk_gauge
from filters.kernels.iteration import iterate
from filters.kernels.landmark_drift import drift, fade
from filters.kernels.landmarks import augment, initialise
from filters.kernels.linearisation import linearise
from filters.kernels.prediction import fuse_odometry, predict, settle
from filters.kernels.progress import counted
from filters.kernels.recipe import Recipe
from filters.kernels.retraction import retract, retract_by_numbers, turn_own, turn_with_world
from filters.kernels.sigma_points import fit


def compiled_calls(recipe: Recipe, fuses: bool, ask: Any) -> Calls:
    """Compile what this recipe calls, or load it from the disk, and say where it is.

    Parameters
    ----------
    recipe : Recipe
        What the filters do.
    fuses : bool
        Whether there is odometry.
    ask : address
        What asks parts without compiled functions.
    """
    plan, needed = recipe.plan, list[Unit]()
    gated = plan.by_numbers or bool((plan.limits < np.inf).any())
    turns = plan.turns or not plan.additive
    scales = plan.moves_by_numbers or plan.resets or not (plan.additive or plan.turns or plan.first_estimates)
    for called, unit in (
        (True, predict),
        (fuses, fuse_odometry),
        (not plan.by_numbers, fit if len(plan.sigma_points) else linearise),
        (gated or plan.tail_dof < np.inf, squared_distances),
        (gated and plan.consensus, largest_agreement),
        (plan.iterations > 1, iterate),
        (True, correct),
        (True, retract_by_numbers if plan.moves_by_numbers else retract),
        (not plan.by_numbers, initialise),
        (True, augment),
        (plan.first_estimates and not plan.moves_by_numbers, settle),
        (bool(plan.drift.any()), drift),
        (plan.memory < np.inf, fade),
        (plan.drop_unseen, drop_unseen),
        (plan.changes and recipe.landmark is not None and recipe.landmark.become is not None, may_change),
        (turns, turn_own),
        (plan.turns, turn_with_world),
        (scales, scale_blocks),
        (plan.moves_by_numbers or plan.turns, shear),
        (plan.gauge_walk > 0.0, walk_gauge),
    ):
        if called:
            needed.append(unit)
    seen = not plan.by_numbers or plan.gauge_walk > 0.0
    moved = turns or plan.first_estimates or plan.gauge_walk > 0.0
    parts: tuple[tuple[str, Any, str, bool], ...] = (
        ("point", recipe.landmark, "point", True),  # maps are read by it, too
        ("start", recipe.landmark, "start", seen),
        *((name, recipe.landmark, name, moved) for name in ("turn", "rotation")),
        ("become", recipe.landmark, "become", plan.changes),
        ("project", recipe.sensor, "project", not plan.by_numbers),
        ("backproject", recipe.sensor, "backproject", not plan.by_numbers),
        ("step", recipe.motion, "step", True),
        ("measure", recipe.motion, "measure", fuses),
    )
    wanted: list[tuple[str, Callable[[], Any]]] = [(unit.name, partial(getattr, unit, "address")) for unit in needed]
    wanted += [(called, partial(of_part, part, name)) for called, part, name, used in parts if used and part]
    where: dict[str, Any] = {"ask": ask}
    with counted(1 + len(wanted)) as count:
        compile_frame()
        count()
        for name, address in wanted:
            where[name] = address()
            count()
    return addresses(**where)
