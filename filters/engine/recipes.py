"""Translation of options to code: the recipe of a filter in plain numbers, and the compiled functions that it needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from filters.contract.outputs import VELOCITY
from filters.engine.frame_arrays import ValuePlaces
from filters.engine.options import Options
from filters.geometry.arrays import IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import settings_of
from filters.geometry.poses import ADDITIVE
from filters.kernels.calls import Calls, Unit, addresses, of_part
from filters.kernels.correction import correct, iterate
from filters.kernels.covariance import scale_blocks, shear
from filters.kernels.frame import become_points, compile_frame, drop_unseen
from filters.kernels.gating import largest_agreement, squared_distances
from filters.kernels.landmarks import augment, initialise
from filters.kernels.lift import functions_of
from filters.kernels.linearisation import linearise
from filters.kernels.prediction import fuse_odometry, predict, settle
from filters.kernels.process_noise import drift, fade, walk_gauge
from filters.kernels.recipe import Functions, Plan, Recipe, stage_tables
from filters.kernels.retraction import retract, turn_own, turn_with_world
from filters.kernels.sigma_points import fit


def recipe_of(camera: StereoCamera, options: Options) -> Recipe:
    """Recipe of a filter, in plain numbers and functions."""
    layout, model, sensor, motion = options.layout, options.landmark, options.measurement, options.motion
    landmark, sensing, driven, error = (functions_of(model), functions_of(sensor), functions_of(motion), options.error)
    sigma_points = options.update.sigma_points(layout.measured + 3 * model.anchored + model.size)
    values, v = ValuePlaces(layout), layout.places[VELOCITY].start
    prior = np.zeros((0, 0)) if model.prior is None else np.array(model.prior, dtype=np.float64)
    turned = [x for x in layout.variables if x.retraction is not ADDITIVE]
    plan = Plan(
        camera=np.array((camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline)),
        landmark=settings_of(model, landmark),
        sensor=settings_of(sensor, sensing),
        motion=settings_of(motion, driven),
        size=model.size,
        prior=prior,
        memory=np.inf if model.memory is None else float(model.memory),
        anchors=int(model.anchored),
        shares_anchors=model.shares_anchors,
        additive=model.additive,
        points=landmark.turn is None,
        follows=_places(model.follows),
        additive_quaternion=error.additive_quaternion,
        first_estimates=error.first_estimates,
        turns=error.turns,
        resets=error.turns and error.reset,
        changes=not model.steady,
        odometry_rows=0 if driven.measure is None else 6,
        consensus=options.consensus,
        tail_dof=np.inf if options.tail_dof is None else float(options.tail_dof),
        iterations=options.iterations,
        relinearise_above=float(options.relinearise_above),
        drop_unseen=options.drop_unseen,
        sigma_points=np.array(sigma_points),
        min_disparity=-np.inf if options.min_disparity is None else float(options.min_disparity),
        measured=layout.measured,
        velocity=v,
        sees_velocity=layout.sees_velocity,
        leading=layout.size,
        sensed=_places(values.of_variables(tuple(variable.name for variable in sensor.variables))),
        moved=_places(values.of_camera(motion.moves[2:])),
        moved_rows=_places(layout.rows_of(motion.moves)),
        in_world=_places([layout.places[x.name].start for x in layout.variables if x.in_world]),
        rotations=np.array(
            [(layout.places[x.name].start, *values.of_variables((x.name,))[:1]) for x in turned], np.int64
        ).reshape(-1, 2),
        considered=layout.considered,
        walk=np.zeros(layout.size) if layout.walk_rates is None else layout.walk_rates,
        drift=np.zeros((2, 4)) if options.drift is None else options.drift.parts,
        gauge_walk=float(options.gauge_walk),
        **stage_tables((sensor.rows(False), sensor.rows(True)), sensor.size, options.gate),
    )
    return Recipe(plan, landmark, sensing, driven, sensor.size, model.value_size, model.seen_size, values.size)


def _places(numbers: Sequence[int] | IntArray) -> IntArray:
    return np.array(numbers, dtype=np.int64)


def compiled_calls(recipe: Recipe, fuses: bool) -> Calls:
    """Compile what this recipe calls, or load it from the disk, and say where it is; with odometry if it `fuses` it."""
    plan, needed = recipe.plan, list[Unit]()
    gated, turns = bool((plan.limits < np.inf).any()), plan.turns or not plan.additive
    for called, unit in (
        (True, predict),
        (fuses, fuse_odometry),
        (True, fit if len(plan.sigma_points) else linearise),
        (gated or plan.tail_dof < np.inf, squared_distances),
        (gated and plan.consensus, largest_agreement),
        (plan.iterations > 1, iterate),
        (True, correct),
        (True, retract),
        (True, initialise),
        (True, augment),
        (plan.first_estimates, settle),
        (bool(plan.drift.any()), drift),
        (plan.memory < np.inf, fade),
        (plan.drop_unseen, drop_unseen),
        (plan.changes, become_points),
        (turns, turn_own),
        (plan.turns, turn_with_world),
        (plan.resets or not (plan.additive or plan.turns or plan.first_estimates), scale_blocks),
        (plan.turns, shear),
        (plan.gauge_walk > 0.0, walk_gauge),
    ):
        if called:
            needed.append(unit)
    moved = turns or plan.first_estimates or plan.gauge_walk > 0.0
    parts: tuple[tuple[str, Functions, bool], ...] = (
        *((name, recipe.landmark, True) for name in ("point", "start")),
        *((name, recipe.landmark, moved) for name in ("turn", "rotation")),
        ("shift", recipe.landmark, plan.gauge_walk > 0.0),
        ("become", recipe.landmark, plan.changes),
        *((name, recipe.sensor, True) for name in ("project", "backproject")),
        ("step", recipe.motion, True),
        ("measure", recipe.motion, fuses),
    )
    functions: list[tuple[str, Callable[[], Any]]] = [(unit.name, partial(getattr, unit, "address")) for unit in needed]
    functions += [(name, partial(of_part, part, name)) for name, part, used in parts if used]
    compile_frame()
    return addresses(**{name: address() for name, address in functions})
