"""Sources of recordings of this package: simulated drives, real recordings, functions."""

from __future__ import annotations

import inspect
import json
import pkgutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import msgspec

from filters.contract.validation import did_you_mean, first_line, require_known, type_name
from stereo_slam_env.benchmark.recordings.source import OpenedImages, Progress, Renderer, Source, checked
from stereo_slam_env.recording.recording import GIVEN_TRUTH, Recording
from stereo_slam_env.sensing.rigs import camera_of
from stereo_slam_env.world.routes import RANDOM_ROUTES, Route, named_route

if TYPE_CHECKING:
    from typing import Self

    import gymnasium as gym

ENTRY_POINT_GROUP = "stereo_slam.sources"
GAZE = "StereoSlam/Gaze-v0"


def _require_frames(frames: int, route: Route, which: str) -> None:
    if frames > route.frames:
        raise ValueError(f"frames must be at most {route.frames} on {which}, got {frames}")


class StreetSource(Source, frozen=True, tag="street"):
    """The PyBullet street of the environment."""

    has_rig: ClassVar[bool] = True
    preloaded: ClassVar[tuple[str, ...]] = ("stereo_slam_env.envs.preload",)

    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    """Arguments of `StereoSlam/Drive-v0`."""

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """Drive the scripted route."""
        from stereo_slam_env.envs.recorder import record  # PyBullet and Gymnasium, only where they are needed

        if not self.takes_images:
            return record(self.options, seed or 0, frames)

        def track() -> Recording:
            tell = progress or (lambda done, total: None)
            return record(self.options, seed or 0, frames, lambda done, wanted: tell(done, wanted or done))

        return _tracked(_Tracking(self.key, seed, frames, track))

    @property
    def at_once(self) -> bool:
        """Whether nothing is drawn and PyBullet is not asked."""
        return not self.takes_images and self.options.get("physics", "exact") == "exact"

    def records(
        self, seeds: Sequence[int | None], frames: int | None = None, progress: Progress | None = None
    ) -> list[Recording]:
        """Drive the scripted route in rows of one simulator."""
        from stereo_slam_env.envs.recorder import records

        tell = progress or (lambda done, total: None)
        numbers = [seed or 0 for seed in seeds]
        return records(self.options, numbers, frames, lambda done, wanted: tell(done, wanted or done))

    def check(self, frames: int | None = None) -> None:
        """Refuse unknown arguments, and a renderer that does not run here."""
        from stereo_slam_env.envs.arguments import DriveOptions

        options = DriveOptions.checked(self.options)
        if options.draws:
            require_renderer(options.renderer)
        if frames is not None and options.route is not None and options.route not in RANDOM_ROUTES:
            _require_frames(frames, named_route(options.route), f"route {options.route!r}")

    def sequence(self, seed: int | None, frames: int | None = None) -> OpenedImages:
        """Rendered image pairs of a drive."""
        from stereo_slam_env.envs.recorder import RenderedDrive

        drive = RenderedDrive(self.options, seed or 0, frames)
        return drive, drive.front_end

    def with_images(self, renderer: Renderer) -> Self:
        """Rendered images instead of geometry."""
        return self.replaced(sensor="images", renderer=renderer)


class GazeSource(Source, frozen=True, tag="gaze"):
    """An environment in which a policy decides where to look."""

    for_policies: ClassVar[bool] = True
    has_rig: ClassVar[bool] = True

    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    """`environment`, its Gymnasium id, `StereoSlam/Gaze-v0` unless said, and its arguments."""

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """Refuse: there is no recording for all policies."""
        raise ValueError("a source of kind 'gaze' has no recording for all: every policy drives its own episode")

    def check(self, frames: int | None = None) -> None:
        """Refuse an environment that cannot be used, too many frames, and a renderer that does not run here."""
        env = self.make_environment()
        route = env.get_wrapper_attr("route")
        env.close()
        if frames is not None:
            _require_frames(frames, route, "the route of its car")
        if self.takes_images:
            require_renderer(self.arguments.get("renderer", "tiny"))

    def make_environment(self) -> gym.Env[Any, Any]:
        """The environment with the moving head.

        Raises
        ------
        ValueError
            There is no such environment, it refuses an argument, its head does not move, or its car follows no route.
        """
        import gymnasium as gym

        from stereo_slam_env.envs.stereo_env import StereoEnv

        arguments = self.options
        name = str(arguments.pop("environment", GAZE))
        if name not in gym.registry:
            ids = sorted(ids for ids in gym.registry if ids.startswith("StereoSlam/"))
            raise ValueError(f"environment must be one of {', '.join(ids)}, got {name!r}{did_you_mean(name, ids)}")
        env = gym.make(name, disable_env_checker=True, max_episode_steps=-1, **arguments)
        core = env.unwrapped
        if not isinstance(core, StereoEnv) or core.head is None:
            raise ValueError(f"environment {name} has no head that a policy could turn: take {GAZE}")
        if getattr(core.options, "policy", "route") != "route":
            raise ValueError(
                f"environment {name} must follow its route, so that all see the same drive: policy = 'route'"
            )
        return env


class ReferenceSource(Source, frozen=True, tag="reference"):
    """Pure geometry, in which the filters' models hold."""

    has_rig: ClassVar[bool] = True

    name: Literal["long_drive", "short_turn", "relative_noise_loop", "inertial_drive", "inertial_flight"]
    """The problem: a function of `reference_problem` or `inertial_problem`."""
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    """Its arguments."""

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """Calculate the drive of a seed."""
        self.check()
        arguments = self.arguments if frames is None else {**self.arguments, "frames": frames}
        return self._problem(seed=seed or 0, **arguments)

    def check(self, frames: int | None = None) -> None:
        """Refuse unknown arguments and impossible rigs."""
        keys = [key for key in inspect.signature(self._problem).parameters if key != "seed"]
        require_known(f"the problem {self.name} has no option", self.arguments, keys)
        if "rig" in self.arguments:
            camera_of(self.arguments["rig"])

    @property
    def _problem(self) -> Callable[..., Recording]:
        from stereo_slam_env.benchmark.recordings import inertial_problem, reference_problem

        module = inertial_problem if self.name.startswith("inertial") else reference_problem
        problem: Callable[..., Recording] = getattr(module, self.name)
        return problem


class DatasetSource(Source, frozen=True, tag="dataset"):
    """A real recording, of tracks or of images, or a stored one."""

    seeded: ClassVar[bool] = False
    isolated: ClassVar[bool] = False

    path: str
    """What `datasets.load` takes."""
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    """Arguments of the reader."""
    reference: dict[str, float | str] = msgspec.field(default_factory=dict)
    """Kind and errors of the truth, in place of what the reader states, see `Reference.stating`."""

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """Read it, or track landmarks through its images."""
        from stereo_slam_env.datasets import load  # OpenCV, only where it is needed
        from stereo_slam_env.frontend.camera_motion import set_up_for_tracks
        from stereo_slam_env.frontend.track_recorder import record_tracks

        def read() -> Recording:
            return load(self.path, **self.arguments)

        if not self.takes_images:
            return self._stated(_tracked(_Tracking(f"{self.key} {_state_of(Path(self.path))}", None, None, read)))

        def track() -> Recording:
            return set_up_for_tracks(record_tracks(*self.sequence(seed), frames=frames, progress=progress))

        return self._stated(_tracked(_Tracking(self.key, seed, frames, track)))

    def check(self, frames: int | None = None) -> None:
        """Refuse a place without a recording, and a kind or errors of the truth that are none."""
        from stereo_slam_env.datasets import EXAMPLE, layout_of_tracks

        GIVEN_TRUTH.stating(self.reference)
        if self.path.partition(":")[0] != EXAMPLE and Path(self.path).suffix != ".npz":
            layout_of_tracks(Path(self.path))

    def _stated(self, recording: Recording) -> Recording:
        if self.reference and recording.reference.kind == "none":
            reference_words = ", ".join(f"{key}={value}" for key, value in self.reference.items())
            raise ValueError(f"reference states {reference_words}, but {self.path} has no true pose: leave it out")
        return replace(recording, truth_from=recording.truth_from.stating(self.reference))

    @property
    def takes_images(self) -> bool:
        """Whether the folder holds images."""
        from stereo_slam_env.datasets import holds_images

        return holds_images(self.path)

    def sequence(self, seed: int | None, frames: int | None = None) -> OpenedImages:
        """The images of the folder."""
        return _opened(json.dumps({"path": self.path, **self.arguments}, sort_keys=True))


class FactorySource(Source, frozen=True, tag="factory"):
    """Any function that returns a `Recording`."""

    runs_code: ClassVar[bool] = True

    call: str
    """As "package.module:function"; it is called with `seed` and the arguments."""
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    """Its arguments."""

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """Call the user's function for a seed."""
        function = resolve_callable('option call must be "package.module:function"', self.call)
        recording = function(seed=seed, **self.arguments)
        if not isinstance(recording, Recording):
            raise ValueError(f"{self.call} returned a {type(recording).__name__}, not a Recording")
        return recording


def resolve_callable(requirement: str, place: str) -> Callable[..., Any]:
    """Resolve "module:name", a class or a function.

    Parameters
    ----------
    requirement : str
        Beginning of the message for another place: "name must be MODULE:CLASS".
    place : str
        The module is imported, so only of somebody whose code may run.

    Raises
    ------
    ValueError
        There is no such module or name in it, or it cannot be called.
    """
    try:
        function: Callable[..., Any] = pkgutil.resolve_name(place)
        if callable(function):
            return function
        raise ValueError("it cannot be called")
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{requirement}, got {place!r}: {error}") from error


def source_of(kind: str, options: Mapping[str, Any]) -> Source:
    """The source of a kind with these options, as a scenario file has them.

    Raises
    ------
    ValueError
        An unknown kind or option, a missing one, or one of the wrong type: the message names it.
    """
    checked("kind", kind, str)
    kinds = _kinds()
    if kind not in kinds:
        for point in entry_points(group=ENTRY_POINT_GROUP):
            if point.name == kind:
                kinds[kind] = _loaded(point)
    if kind not in kinds:
        raise ValueError(f"kind must be one of {', '.join(map(str, kinds))}, got {kind!r}{did_you_mean(kind, kinds)}")
    return kinds[kind].of(options)


def require_renderer(name: str) -> None:
    """Raise a `ValueError`, in one line, if nothing can be drawn with that renderer here."""
    from stereo_slam_env.rendering.renderers import renderer_identity

    try:
        renderer_identity(name)
    except (ImportError, RuntimeError) as error:
        raise ValueError(str(error)) from error


def known_kinds() -> str:
    """The kinds of sources that are loaded, for messages."""
    return ", ".join(map(str, _kinds()))


def _kinds() -> dict[Any, type[Source]]:
    kinds: dict[Any, type[Source]] = {}
    for kind in _subclasses(Source):
        kinds.setdefault(kind.__struct_config__.tag, kind)  # ours come first and stay
    return kinds


def _subclasses(kind: type[Source]) -> Iterator[type[Source]]:
    for subclass in kind.__subclasses__():
        yield subclass
        yield from _subclasses(subclass)


def _loaded(point: EntryPoint) -> type[Source]:
    try:
        loaded = point.load()
    except Exception as error:  # whatever a stranger's module does at import must not take the run down
        raise ValueError(
            f"kind {point.name!r} ({point.value}) cannot be loaded: {type_name(error)}: {first_line(error)}"
        ) from error
    if not (isinstance(loaded, type) and issubclass(loaded, Source)):
        raise ValueError(f"kind {point.name!r} ({point.value}) is no subclass of Source")
    return loaded


@dataclass(frozen=True)
class _Tracking:
    """Reading of tracks, or tracking through images, which is the same whoever is told of its progress."""

    key: str
    seed: int | None
    frames: int | None
    track: Callable[[], Recording] = field(compare=False)


@lru_cache(maxsize=1)
def _tracked(tracking: _Tracking) -> Recording:
    """The recording; kept, because tracking, and measuring the noise of tracks, takes longer than filtering."""
    return tracking.track()


def _state_of(path: Path) -> list[tuple[str, int, int]]:
    """Names, times of change and sizes of the files of a folder, or of one file."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    file_states = [(file.name, file.stat()) for file in files if file.exists()]
    return [(name, about.st_mtime_ns, about.st_size) for name, about in file_states]


@lru_cache(maxsize=1)
def _opened(options: str) -> OpenedImages:
    """Opened recording of images; kept, because finding its calibration takes time."""
    from stereo_slam_env.datasets import open_for_front_end

    return open_for_front_end(**json.loads(options))
