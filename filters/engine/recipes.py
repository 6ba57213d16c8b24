"""From options to code: the recipe of a filter in plain numbers, and the compiled functions that it needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from filters.contract.variables import VELOCITY
from filters.engine.frames import ValuePlaces
from filters.engine.options import Options
from filters.errors.error_definition import ErrorKernels
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import settings_of
from filters.geometry.retractions import ADDITIVE
from filters.kernels.calls import Calls, Unit, addresses, of_part
from filters.kernels.compilation import counted
from filters.kernels.correction import correct
from filters.kernels.covariance import scale_blocks, shear
from filters.kernels.frame import compile_frame, drop_unseen, may_change
from filters.kernels.gating import largest_agreement, squared_distances
from filters.kernels.iteration import iterate
from filters.kernels.landmarks import augment, initialise
from filters.kernels.lift import compiled_functions
from filters.kernels.linearisation import linearise
from filters.kernels.prediction import fuse_odometry, predict, settle
from filters.kernels.process_noise import drift, fade, walk_gauge
from filters.kernels.recipe import Plan, Recipe, stage_tables
from filters.kernels.retraction import retract, retract_by_numbers, turn_own, turn_with_world
from filters.kernels.sigma_points import fit
from filters.parts import SLOTS


def recipe_of(camera: StereoCamera, options: Options) -> Recipe:
    """What a filter does, in plain numbers; where parts have no kernels, by their numbers."""
    layout, model, sensor, motion = options.layout, options.landmark, options.measurement, options.motion
    landmark, error = compiled_functions(model), compiled_functions(options.error)
    # Kernels know no other linearisation point and no other constraint than those of `FirstEstimates`.
    own_jacobians = error is None and (options.error.constrains or not options.error.linearises_at_the_state)
    seen = compiled_functions(sensor)
    driven = None if own_jacobians else compiled_functions(motion)
    by_numbers = own_jacobians or landmark is None or seen is None or not compiled_functions(options.update)
    sigma_points = options.update.sigma_points(layout.measured + 3 * model.anchored + model.size)
    by_numbers |= bool(sigma_points) and landmark is not None and landmark.turn is None and not model.additive
    turns = error is not None and error.turns
    moves_by_numbers = (
        error is None
        or (landmark is None and (turns or not model.additive))
        or any(variable.retraction is not ADDITIVE for variable in layout.variables)
    )
    has_place = landmark is not None and (model.anchored or landmark.turn is None)
    values, flags = ValuePlaces(layout), error or ErrorKernels()
    v = layout.places[VELOCITY].start
    prior = np.zeros((0, 0)) if model.prior is None else np.array(model.prior, dtype=np.float64)
    plan = Plan(
        camera=np.array((camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline)),
        landmark=_settings(model, landmark),
        sensor=_settings(sensor, None if by_numbers else seen),
        motion=_settings(motion, driven),
        size=model.size,
        prior=prior,
        memory=np.inf if model.memory is None else float(model.memory),
        anchors=2 if model.in_anchor else int(model.anchored),
        shares_anchors=model.shares_anchors,
        additive=model.additive,
        points=landmark is not None and landmark.turn is None,
        follows=_places(model.follows),
        additive_quaternion=flags.additive_quaternion,
        first_estimates=flags.first_estimates,
        turns=flags.turns,
        resets=flags.turns and options.error.reset,
        by_numbers=by_numbers,
        moves_by_numbers=moves_by_numbers,
        changes=not model.steady,
        walks_by_numbers=bool(options.gauge_walk) and (own_jacobians or not has_place),
        driven_by_numbers=driven is None,
        odometry_rows=0 if driven is None or driven.measure is None else 6,
        consensus=options.consensus,
        tail_dof=np.inf if options.tail_dof is None else float(options.tail_dof),
        iterations=options.iterations,
        relinearise_above=float(options.relinearise_above),
        drop_unseen=options.drop_unseen,
        sigma_points=np.array(() if by_numbers else sigma_points),
        min_disparity=-np.inf if options.min_disparity is None else float(options.min_disparity),
        measured=layout.measured,
        velocity=v,
        sees_velocity=layout.sees_velocity,
        leading=layout.size,
        sensed=_places(values.of_variables(tuple(variable.name for variable in sensor.variables))),
        moved=_places(() if driven is None else values.of_camera(motion.moves[2:])),
        moved_rows=_places(() if driven is None else layout.rows_of(motion.moves)),
        in_world=_places([layout.places[x.name].start for x in layout.variables if x.in_world]),
        considered=layout.considered,
        walk=np.zeros(layout.size) if layout.walk_rates is None else layout.walk_rates,
        drift=np.zeros((2, 4)) if options.drift is None else options.drift.parts,
        gauge_walk=float(options.gauge_walk),
        **stage_tables((sensor.rows(False), sensor.rows(True)), sensor.size, options.gate),
    )
    return Recipe(
        plan,
        landmark,
        None if by_numbers else seen,
        driven,
        sensor.size,
        model.value_size,
        model.seen_size,
        values.size,
        tuple(getattr(options, slot) for slot in SLOTS if not compiled_functions(getattr(options, slot))),
    )


def _settings(part: object, kernels: Any) -> FloatArray:
    return np.zeros(0) if kernels is None else settings_of(part, kernels)


def _places(numbers: Sequence[int] | IntArray) -> IntArray:
    return np.array(numbers, dtype=np.int64)


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
