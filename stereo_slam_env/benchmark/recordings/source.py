"""Interface of the sources of recordings, and checks of plain data: types by `msgspec`, and bounds of numbers.

A source is tagged data: `kind` names its class, and its fields are the table `options` of a scenario file. A new source
is a subclass of `Source` with a tag, its fields and `record`::

    class BagSource(Source, frozen=True, tag="bag"):
        path: str
        topic: str = "/stereo"

        def record(self, seed, frames=None, progress=None): ...

It is known as soon as its module is imported. Scenario files and the command line find that of an installed package by
an entry point in the group `stereo_slam.sources`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args, get_origin

import msgspec

from filters.contract.validation import did_you_mean, require_known
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import ImageSequence, Recording
from stereo_slam_env.sensing.rigs import plain_rig

if TYPE_CHECKING:
    from typing import Self

    import gymnasium as gym

Progress = Callable[[int, int], None]
OpenedImages = tuple[ImageSequence, TrackerSettings]
Renderer = Literal["tiny", "gl"]
_PLAIN = {"array": "a list", "object": "a table", "str": "text", "int": "a whole number", "float": "a number"}
_PLAIN |= {"bool": "true or false", "null": "none"}
_SHOWN = 100
"""characters: of a value in a message."""
FILE_NAME = r"^[A-Za-z0-9][A-Za-z0-9._+-]*\Z"
"""Pattern of names that are usable as those of files."""
_OF_FILE_NAME = "of letters, digits and . _ + -, with a letter or digit first"


class Source(msgspec.Struct, frozen=True, tag_field="kind", forbid_unknown_fields=True):
    """Source of the recordings of a scenario.

    Fields are JSON-able. A field `arguments`, a dict, takes the options that have no field of their own.
    """

    seeded: ClassVar[bool] = True
    """Whether there is a recording for each seed, or only one."""
    isolated: ClassVar[bool] = True
    """Whether a recording is made in a process of its own: it is drawn or calculated, not only read."""
    for_policies: ClassVar[bool] = False
    """Whether policies decide where to look, so that each of them drives its own episode."""
    has_rig: ClassVar[bool] = False
    """Whether the camera is simulated, with a rig that the option `rig` chooses."""
    runs_code: ClassVar[bool] = False
    """Whether the options name code to be run, for which `load_study` asks for consent."""
    preloaded: ClassVar[tuple[str, ...]] = ()
    """Modules that processes which make many recordings are started with."""

    @property
    def kind(self) -> str:
        """Kind of the source, its tag in files."""
        return str(self.__struct_config__.tag)

    @property
    def options(self) -> dict[str, Any]:
        """The fields that differ from their defaults, JSON-able: the table `options` of a scenario file."""
        defaults = {about.name: about.default for about in msgspec.structs.fields(self) if about.name != "arguments"}
        options_given = {
            name: getattr(self, name) for name, default in defaults.items() if getattr(self, name) != default
        }
        options: dict[str, Any] = msgspec.to_builtins({**options_given, **getattr(self, "arguments", {})})
        return options

    @property
    def key(self) -> str:
        """Identity of the source, as JSON."""
        return json.dumps([self.kind, self.options], sort_keys=True)

    def __str__(self) -> str:
        return f"{self.kind} {json.dumps(self.options)}"

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Self:
        """The source with these options, as a scenario file has them.

        Raises
        ------
        ValueError
            An option is unknown, missing or of the wrong type: the message names it.
        """
        checked("options", options, dict[str, Any])
        if cls.has_rig and "rig" in options:  # a calibration file is read now: what is stored must be what happens
            options = {**options, "rig": plain_rig(options["rig"])}
        named_fields = [name for name in cls.__struct_fields__ if name != "arguments"]
        fields = {name: value for name, value in options.items() if name in named_fields}
        other_options = {name: value for name, value in options.items() if name not in named_fields}
        if "arguments" in cls.__struct_fields__:
            fields["arguments"] = other_options
        else:
            require_known(f"a source of kind {cls.__struct_config__.tag!r} has no option", other_options, named_fields)
        try:
            plain = msgspec.to_builtins(fields)
        except TypeError as error:
            raise ValueError(f"options must consist of JSON values: {error}") from error
        source: Self = checked("options", plain, cls)
        return source

    def replaced(self, **options: Any) -> Self:
        """The source with these options in place of its own."""
        return type(self).of({**self.options, **options})

    def record(self, seed: int | None, frames: int | None = None, progress: Progress | None = None) -> Recording:
        """The recording of a seed.

        Parameters
        ----------
        seed : int, optional
            None where the source has no seeds.
        frames : int, optional
            Most frames that are needed.
        progress : callable, optional
            Called with (pairs done, pairs) where measurements come from images.

        Raises
        ------
        ValueError
            The options are refused: the message names what is wrong.
        """
        raise NotImplementedError

    @property
    def at_once(self) -> bool:
        """Whether `records` makes many recordings faster than `record` makes them one by one."""
        return False

    def records(
        self, seeds: Sequence[int | None], frames: int | None = None, progress: Progress | None = None
    ) -> list[Recording]:
        """The recordings of some seeds, each as `record` makes it, to the bit; only where they come `at_once`.

        `progress` is called as a sign of life.
        """
        raise NotImplementedError

    def check(self, frames: int | None = None) -> None:
        """Raise a `ValueError` for options that cannot be used, before any work is done."""

    @property
    def takes_images(self) -> bool:
        """Whether the measurements come from images through the front end."""
        return self.has_rig and self.options.get("sensor") == "images"

    def sequence(self, seed: int | None, frames: int | None = None) -> OpenedImages:
        """The images of a seed, and the settings of the front end for them; only where `takes_images`."""
        raise ValueError(f"a source of kind {self.kind!r} has no images")

    def with_images(self, renderer: Renderer) -> Self:
        """The same drive measured in rendered images.

        Raises
        ------
        ValueError
            The source draws none.
        """
        raise ValueError(f"--sensor images needs a scenario of kind 'street', this one is of kind {self.kind!r}")

    def make_environment(self) -> gym.Env[Any, Any]:
        """The environment in which policies look; only where `for_policies`."""
        raise ValueError(f"a source of kind {self.kind!r} has no environment for policies")


class CheckedStruct(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Plain data whose fields have their declared types, whether made by hand or decoded from a file."""

    _of: ClassVar[str] = ""
    """For messages, after the name of a field."""

    def __post_init__(self) -> None:
        for name, kind in _types(type(self)).items():
            value = getattr(self, name)
            if not isinstance(value, msgspec.Struct | msgspec.UnsetType):  # a struct was checked when it was made
                msgspec.structs.force_setattr(self, name, checked(f"{name}{self._of}", value, kind))

    def replaced(self, **changes: Any) -> Self:
        """Copy with other values of some fields, checked anew."""
        return msgspec.structs.replace(self, **changes)


@cache
def _types(kind: type[msgspec.Struct]) -> dict[str, Any]:
    return {about.name: about.type for about in msgspec.structs.fields(kind)}


def checked(what: str, value: Any, kind: Any) -> Any:
    """The value as `kind`, a type that `msgspec` knows; else a `ValueError` of one line that begins with `what`."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        if error.__cause__ is not None:  # a struct that checks itself
            raise ValueError(str(error.__cause__)) from error
        if get_origin(kind) is dict and "`$[" in str(error):  # which does not name the key
            for key, entry in value.items():
                checked(f"{what}.{key}", entry, get_args(kind)[1])
        raise ValueError(_in_words(what, value, kind, str(error))) from error


def _in_words(what: str, value: Any, kind: Any, message: str) -> str:
    """Error message of `msgspec` reworded: the place, the expected value, the value, and a suggestion."""
    message, _, path = message.partition(" - at `$")
    for step in re.findall(r"[^.\[\]`]+", path):
        value = value[int(step) if step.isdecimal() else step]
    place = what + path.rstrip("`")
    if message.startswith("Object missing"):
        return f"{place} must have {message.split('`')[1]}"
    if message.startswith("Object contains unknown"):
        return f"{place} has no key {message.split('`')[1]!r}: leave it out"
    if message.startswith("Invalid enum value"):
        allowed = [str(word) for word in _words(kind)]
        return f"{place} must be one of {', '.join(allowed)}, got {value!r}{did_you_mean(value, allowed)}"
    expected = re.sub(", got `.*`$", "", message.removeprefix("Expected "))
    expected = re.sub(r"`([\w |]+)`", lambda m: " or ".join(_PLAIN.get(w, w) for w in m[1].split(" | ")), expected)
    expected = re.sub("matching regex .*", _OF_FILE_NAME, expected) if FILE_NAME[:-2] in expected else expected
    words = repr(value)
    return f"{place} must be {expected}, got {words if len(words) <= _SHOWN else words[:_SHOWN] + '...'}"


def _words(kind: Any) -> Iterator[Any]:
    """The values of all `Literal`s in a type."""
    parts = get_args(kind)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        parts = tuple(about.type for about in msgspec.structs.fields(kind))
    for part in parts:
        if get_origin(kind) is Literal:
            yield part
        else:
            yield from _words(part)


# ---- bounds: numbers of time, memory and arithmetic ------------------------------------------------------------------

MOST_SEED = 2**63 - 1
"""Seeds are kept in tables of 64 bits."""
MOST_CORRUPTIONS = 100
MOST_FRAMES = 1_000_000
MOST_SECONDS = 1e6
_MOST: Mapping[str, float] = {
    **dict.fromkeys(("landmarks", "max_landmarks", "refill_below"), 10_000),
    **dict.fromkeys(("moving_cars", "pedestrians"), 1_000),
    **dict.fromkeys(("iterations", "supersample"), 1_000),
    **dict.fromkeys(("width", "height"), 20_000),
    **dict.fromkeys(("frames", "first", "last"), MOST_FRAMES),
    **dict.fromkeys(("sigma", "independent_pixels", "diagonal"), 1e6),
}
"""By the last key that leads to a number; squares of the last ones are within what filters take for an R, px^2."""
_MOST_OTHERS = 1e12
_DEEPEST, _LONGEST = 20, 1_000_000


def require_bounded(what: str, value: Any, key: str = "", depth: int = 0) -> None:
    """Raise a `ValueError` that names the place, value and bound of a number in plain data that is too large.

    `key` is the last one that leads to it, `depth` the tables and lists around it.
    """
    if isinstance(value, Mapping | list | tuple):
        if depth > _DEEPEST or len(value) > _LONGEST:
            raise ValueError(f"{what} must have at most {_LONGEST} entries, {_DEEPEST} levels deep, got {len(value)}")
        if isinstance(value, Mapping):
            for name, entry in value.items():
                require_bounded(f"{what}.{name}", entry, str(name), depth + 1)
        else:
            for number, entry in enumerate(value):
                require_bounded(f"{what}[{number}]", entry, key, depth + 1)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        most = MOST_SEED if "seed" in key else _MOST.get(key, _MOST_OTHERS)
        if value < -most or value > most:  # what is no number is none of JSON, either
            told = f"{value:.6g}" if isinstance(value, float) or abs(value) < 10**30 else f"{str(value)[:20]}..."
            raise ValueError(f"{what} must be a number of at most {most:g}, got {told}")
