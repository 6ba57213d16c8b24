"""Moving bodies in the state against rejection, perfect removal, and movers taken for static, on drives through a town.

    python benchmarks/bodies_in_town.py                         # 20 drives at 0.5 px, at 1 px, behind buses: 15 minutes
    python benchmarks/bodies_in_town.py --only town --seeds 4   # fewer
    python benchmarks/bodies_in_town.py --only bus --odometry   # with that of the wheels

Seeds begin at 100: association was chosen on others. `told` is the filter with the true body of each measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import stereo_slam_env as sse
from harness import arguments, by_seed, show
from stereo_slam_env.recording.recording import Frame

FIRST_SEED = 100
TOWN = {"moving_cars": 30, "pedestrians": 10, "moving_landmarks": 12, "max_landmarks": 90}
BUS = {"moving_landmarks": 80, "max_landmarks": 16}
WORLDS = {
    "town": {**TOWN, "sigma": 0.5},
    "town, 1 px": {**TOWN, "sigma": 1.0},
    "bus pulls away": {**BUS, "sigma": 0.5, "bus": "pulls-away"},
    "bus leads": {**BUS, "sigma": 0.5, "bus": "leads"},
}
FIGURES = {
    "pose NEES/6": "body_pose_nees", "median": "body_pose_nees_median", "twist NEES/6": "body_twist_nees",
    "speed m/s": "body_speed_error_median_m_s", "found %": "bodies_found_percent",
    "false": "bodies_false", "swapped %": "body_swapped_percent", "delay s": "body_delay_s",
    "movers static %": "mover_points_used_as_static_percent", "static on bodies %": "static_points_on_bodies_percent",
}  # fmt: skip
COLUMNS = ["filter", "rms m", "median m", "worst m", "worst / removed", "lost"]
LOST = 5.0  # m
SCALES = {name: 6.0 for name in FIGURES.values() if name.endswith(("nees", "nees_median"))}
MOTION = {"name": "constant-velocity", "sigma_acceleration": 3.0, "sigma_angular_acceleration": 0.6}


def removed(frame: Frame) -> Frame:
    """The frame without measurements of bodies."""
    stands = frame.bodies.of_measurements < 0
    bodies = replace(frame.bodies, of_measurements=frame.bodies.of_measurements[stands])
    return replace(frame, observation=frame.observation.select(stands), bodies=bodies)


def told(frame: Frame) -> Frame:
    """The frame whose observation names the body of each measurement."""
    return replace(frame, observation=replace(frame.observation, bodies=frame.bodies.of_measurements))


def as_it_is(frame: Frame) -> Frame:
    """The frame as the sensor gives it."""
    return frame


STATIC = {"bodies": None, "gate": None, "consensus": False}
FILTERS: dict[str, tuple[Callable[[Frame], Frame], dict[str, object]]] = {
    "removed by truth": (removed, {"bodies": None, "consensus": False}),
    "bodies, told": (told, {"consensus": False}),
    "bodies": (as_it_is, {}),
    "rejection": (as_it_is, {"bodies": None}),
    "taken for static": (as_it_is, STATIC),
}


def drive(seed: int, world: str, odometry: bool) -> tuple[float, dict[str, dict[str, float]]]:
    """Static points a frame, and the figures of each filter, on one drive."""
    recording = sse.record("StereoSlam/Drive-v0", seed=seed, policy="route", route="town", frames=150, **WORLDS[world])
    static_points = np.mean([(frame.bodies.of_measurements < 0).sum() for frame in recording.frames])
    figures = {}
    for name, (change, options) in FILTERS.items():
        changed = replace(recording, frames=tuple(map(change, recording.frames)))
        settings = {"motion": MOTION, "use_odometry": odometry, **options}
        figures[name] = sse.evaluate("moving-bodies", changed, **settings).figures.as_dict()
    return float(static_points), figures


def main() -> None:
    """Run the drives of each world, and print a table and two sentences of it."""
    options = arguments(__doc__, seeds=20, only="", odometry=False, jobs=1)
    for world in WORLDS:
        if options.only not in world:
            continue
        seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
        static_points, figures = zip(*by_seed(drive, seeds, options.jobs, world, options.odometry), strict=True)
        errors = {name: np.array([one[name]["position_rmse_m"] for one in figures]) for name in FILTERS}
        rows = []
        for name, rmse in errors.items():
            ratios = rmse / errors["removed by truth"]
            ego = np.sqrt(np.mean(rmse**2)), np.median(rmse), rmse.max(), ratios.max()
            row = [name, *(f"{value:.3f}" for value in ego), str(int((rmse > LOST).sum()))]
            for figure in FIGURES.values():
                numbers = [one[name][figure] for one in figures if one[name].get(figure) is not None]
                combined = (sum if figure == "bodies_false" else np.mean)(numbers) if numbers else None
                row.append("" if combined is None else f"{combined / SCALES.get(figure, 1.0):.2f}")
            rows.append(row)
        show(f"{world}: {options.seeds} drives", [*COLUMNS, *FIGURES], rows)
        paired = np.log(errors["bodies"] / errors["rejection"])
        mean, half = paired.mean(), 1.96 * paired.std(ddof=1) / np.sqrt(len(paired))
        print(
            f"bodies against rejection, ratio of errors: {np.exp(mean):.2f} [{np.exp(mean - half):.2f}, "
            f"{np.exp(mean + half):.2f}], paired, 95 %; static points a frame {np.mean(static_points):.1f}"
        )
        few = [f"{n:.1f}: {e:.2f}" for n, e in zip(static_points, errors["bodies"], strict=True) if e > LOST]
        print(f"lost with bodies, static points a frame and error, m: {', '.join(few) or 'none'}\n")


if __name__ == "__main__":
    main()
