"""From a scenario and a seed to the recording every filter is given."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from filters.interface import StereoObservation
from filters.known_names import require_known
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.datasets import holds_images, load, open_for_front_end
from stereo_slam_env.frontend.recorder import record_tracks
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import ImageSequence, Recording
from stereo_slam_env.sensing.corruptions import corrupted, make_corruption
from stereo_slam_env.sensing.rigs import camera_of

Progress = Callable[[int, int], None]


def make_recording(scenario: Scenario, seed: int | None, progress: Progress | None = None) -> Recording:
    """The measurement stream of `scenario` for `seed` (None for a real recording).

    Where it comes from images, `progress` is called with (pairs done, pairs) after each.

    Raises
    ------
    ValueError
        The source refuses its options or yields no frames: the message names what is wrong.
    """
    options = dict(scenario.options)
    if scenario.kind == "gaze":
        raise ValueError(f"scenario {scenario.name!r} has no recording for all: every policy drives its own episode")
    if takes_images(scenario):
        given = json.dumps(options, sort_keys=True)
        recording = _seen(_Look(scenario.kind, given, seed, scenario.frames, progress))
    elif scenario.kind == "street":
        recording = _street(options, seed, scenario.frames)
    elif scenario.kind == "reference":
        recording = _reference(options, seed, scenario.frames)
    elif scenario.kind == "dataset":
        if "path" not in options:
            raise ValueError("a scenario of kind 'dataset' needs the option path")
        recording = load(options.pop("path"), **options)
    else:
        recording = _called(options, seed)
    if scenario.frames is not None:
        recording = dataclasses.replace(recording, frames=recording.frames[: scenario.frames])
    if scenario.corruptions:
        recording = corrupted(recording, scenario.corruptions, seed or 0)
    if len(recording) == 0:
        raise ValueError(f"recording {recording.name!r} has no frames")
    return recording


def takes_images(scenario: Scenario) -> bool:
    """Whether the measurements come from images through the front end."""
    if scenario.kind in ("street", "gaze"):
        return scenario.options.get("sensor") == "images"
    return scenario.kind == "dataset" and holds_images(str(scenario.options.get("path", "")))


def make_sequence(scenario: Scenario, seed: int | None) -> tuple[ImageSequence, TrackerSettings]:
    """The images of a scenario that has them, and the settings of the front end for them.

    Raises
    ------
    ValueError
        The scenario has no images, or its options are refused.
    """
    options = dict(scenario.options)
    if not takes_images(scenario):
        raise ValueError(f"scenario {scenario.name!r} has no images: give sensor='images' or a recording of images")
    if scenario.kind == "street":
        from stereo_slam_env.envs.options import DriveOptions
        from stereo_slam_env.envs.rendered_drive import RenderedDrive

        return RenderedDrive(options, seed or 0, scenario.frames), DriveOptions.checked(options).front_end
    return _opened(json.dumps(options, sort_keys=True))


def check_source(scenario: Scenario) -> None:
    """Raise a `ValueError` for a source that cannot be used as the scenario says, before any work is done."""
    sees = takes_images(scenario)
    if scenario.search == "forecast" and scenario.kind == "gaze":
        raise ValueError("search 'forecast' does not go with kind 'gaze': its environments have their own front end")
    if scenario.search == "forecast" and not sees:
        raise ValueError(f"search 'forecast' needs images: scenario {scenario.name!r} has none")
    if scenario.noise is not None and sees:
        raise ValueError(
            f"scenario {scenario.name!r} must not assume a noise (--sigma-px): in images each measurement comes with "
            f"its own covariance"
        )
    for corruption in scenario.corruptions:
        make_corruption(corruption)
    if scenario.kind == "gaze":
        from stereo_slam_env.benchmark.recordings.episodes import check_episodes

        check_episodes(scenario)
        drawn_by = scenario.options.get("renderer", "tiny") if sees else None
    elif scenario.kind == "street":
        from stereo_slam_env.envs.options import DriveOptions

        options = DriveOptions.checked(scenario.options)
        drawn_by = options.renderer if options.draws else None
    elif scenario.kind == "reference":
        _reference_problem(scenario.options)
        return
    else:
        return
    if drawn_by is not None:
        require_renderer(drawn_by)


def require_renderer(name: str) -> None:
    """Raise a `ValueError`, in one line, if nothing can be drawn with that renderer here."""
    from stereo_slam_env.rendering.backends import renderer_identity

    try:
        renderer_identity(name)
    except (ImportError, RuntimeError) as error:
        raise ValueError(str(error)) from error


def without_measurements(recording: Recording) -> Recording:
    """The drive as filters know it that measure for themselves; ids of landmarks are theirs then, so truth has none."""
    none = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    frames = tuple(dataclasses.replace(frame, observation=none) for frame in recording.frames)
    return dataclasses.replace(recording, frames=frames, landmarks=None)


@dataclass(frozen=True)
class _Look:
    """What is looked at; who is told about it makes no difference."""

    kind: str
    options: str
    seed: int | None
    frames: int | None
    progress: Progress | None = field(compare=False)


@lru_cache(maxsize=1)
def _seen(look: _Look) -> Recording:
    """Tracks through images; kept, because looking takes far longer than filtering."""
    if look.kind == "street":
        return _street(json.loads(look.options), look.seed, look.frames, look.progress)
    return record_tracks(*_opened(look.options), frames=look.frames, progress=look.progress)


@lru_cache(maxsize=1)
def _opened(options: str) -> tuple[ImageSequence, TrackerSettings]:
    """A recording of images; kept, because its calibration is looked for."""
    return open_for_front_end(**json.loads(options))


def _street(
    options: dict[str, Any], seed: int | None, frames: int | None, progress: Progress | None = None
) -> Recording:
    from stereo_slam_env.envs.recorder import record  # PyBullet and Gymnasium, only where they are needed

    def tell(done: int, wanted: int | None) -> None:
        if progress is not None:
            progress(done, wanted or done)

    return record(options, seed=seed or 0, frames=frames, progress=tell)


def _reference(options: dict[str, Any], seed: int | None, frames: int | None) -> Recording:
    problem = _reference_problem(options)
    del options["name"]
    if frames is not None:
        options["frames"] = frames
    return problem(seed=seed or 0, **options)


def _reference_problem(options: Mapping[str, Any]) -> Callable[..., Recording]:
    """The function that a scenario of kind "reference" calls; an unknown option or rig is refused."""
    from stereo_slam_env.benchmark.recordings.large_rotation_problem import relative_noise_loop
    from stereo_slam_env.benchmark.recordings.reference_problem import long_drive, short_turn

    problems: dict[str, Callable[..., Recording]] = {
        "long_drive": long_drive,
        "short_turn": short_turn,
        "relative_noise_loop": relative_noise_loop,
    }
    name = options.get("name")
    if name not in problems:
        raise ValueError(f"option name of a 'reference' scenario must be one of {', '.join(problems)}, got {name!r}")
    known = [key for key in inspect.signature(problems[name]).parameters if key != "seed"]
    require_known(f"the problem {name} has no option", options, ("name", *known))
    if "rig" in options:
        camera_of(options["rig"])
    return problems[name]


def _called(options: dict[str, Any], seed: int | None) -> Recording:
    target = options.pop("call", "")
    module_name, _, function_name = str(target).partition(":")
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f'option call must be "package.module:function", got {target!r}: {error}') from error
    recording = function(seed=seed, **options)
    if not isinstance(recording, Recording):
        raise ValueError(f"{target} returned a {type(recording).__name__}, not a Recording")
    return recording
