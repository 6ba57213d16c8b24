"""Identity of the code that made a result, ours and that of others: a digest of its files, and versions of the rest.

Every file of both packages counts, and there is no list of those that "make no result": such a list is kept by hand,
and where it is wrong, a stale result passes for a new one. Nor does an import graph say what counts: names are strings.

Code that somebody else wrote counts where a scenario names it: filters, policies, parts, front ends and sources by
their entry points, and "module:name". The digest is:

- of an installed distribution: its version and the record of its files, and its code as it lies there;
- of a project of the user, in place or installed as editable: all code of the top-level package (or script) that
  defines it, and of those beside it that it imports, directly or by others;
- of a class without a file, as in a notebook: its compiled code, and that of what it refers to in there.

Classes that it is derived from count likewise. Data that it loads by itself does not count, unless it is part of an
installed distribution. Bytes are compared: an edited comment makes a result that of other code, too, because a rule
that says which edits matter is where a stale result would pass for a new one.
"""

from __future__ import annotations

import ast
import glob
import hashlib
import importlib.machinery
import importlib.util
import inspect
import platform
import re
import sys
import sysconfig
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cache, lru_cache, partial
from importlib.metadata import Distribution, EntryPoint, entry_points, packages_distributions
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.validation import error_line
from stereo_slam_env.benchmark.recordings.source import Source
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.files.opening import read_bytes
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.recording.trajectory_bags import bag_and_topic

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("filters", "stereo_slam_env")
"""Those of this project."""
_DISTRIBUTIONS = ("stereo-slam-env", "numpy", "scipy", "numba", "gymnasium", "pybullet", "joblib")


@cache
def code_digest(root: Path = ROOT) -> str:
    """SHA-256 of the files of both packages in the folder `root`, so that results of different code are never mixed.

    Data such as trained networks count. It is asked for once a run, by the process that keeps the results.
    """
    files = (path for package in PACKAGES for path in source_files(root / package))
    return digest_of({path.relative_to(root).as_posix(): _digest(path.read_bytes()) for path in files})


def versions() -> dict[str, str]:
    """Versions of Python, of this code and of the packages that results depend on."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "code": code_digest(),
        **{package: version_of(package) for package in _DISTRIBUTIONS},
    }


def source_files(folder: Path) -> list[Path]:
    """Every file below a folder but hidden ones and what Python and Numba keep there, in order."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path for path in files if not any(_is_kept(part) for part in path.relative_to(folder).parts))


def _is_kept(name: str) -> bool:
    return name == "__pycache__" or name.startswith(".")


def digest_of(digests: Mapping[str, str]) -> str:
    """One digest of many, by name."""
    lines = sorted(f"{name} {digest}" for name, digest in digests.items())
    return _digest("\n".join(lines).encode())[:16]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


_CODE = tuple({*importlib.machinery.all_suffixes()} - {*importlib.machinery.BYTECODE_SUFFIXES})
_INSTALLED = tuple({Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib")})
_GROUPS = "stereo_slam."
"""Begins the groups of entry points of every kind of plug-in."""
_UNNAMED = ("stereo_slam.recordings", "stereo_slam.scenes")
"""Groups whose entries are asked by their contents, not by their names: layouts, and registrations of scenes."""
_MODULE = re.compile(r"([A-Za-z_]\w*)(?:\.\w+)*:\S+")
_ENVIRONMENT = re.compile(r"[\w./-]+-v\d+")
_NOT_THEIRS = {*PACKAGES, *sys.stdlib_module_names}


def digest_of_choice(choice: FilterChoice) -> str | None:
    """Digest of the code of a competitor, or of its files; None where all of it is ours.

    That is the code of its filter and its policy, and of every part that their options name.
    """
    if choice.is_outside:
        return _digest_of_files(choice)
    policy = {} if choice.policy is None else choice.policy.as_dict()
    return "-".join(_digests_of_names([choice.as_dict(), policy])) or None


def _digest_of_files(choice: FilterChoice) -> str:
    """Digest of the trajectories of a competitor from outside, of all recordings."""
    digest = hashlib.sha256()
    name = str(choice.options["file"])
    bag = bag_and_topic(name)
    places = [str(bag[0])] if bag else sorted(glob.glob(glob.escape(name).replace(r"{seed}", "*")))
    for place in [*places, *filter(None, [choice.options.get("body")])]:
        for path in [Path(place)] if not Path(place).is_dir() else sorted(Path(place).iterdir()):
            digest.update(read_bytes(path) if path.is_file() else b"")
    return digest.hexdigest()[:16]


def digest_of_source(source: Source, *others: Any) -> str | None:
    """Digest of the code that makes the recordings; None where all of it is ours.

    `others` are fields of the scenario that have a share in them, as plain data. Functions and environments that are
    named with their module are not imported for that.
    """
    module = type(source).__module__
    of_class = {} if _top(module) in _NOT_THEIRS else _package(_top(module), None)
    named = _digests_of_names([source.kind, source.options, *others], asked_by_all=_UNNAMED)
    return "-".join([*([digest_of(of_class)] if of_class else []), *named]) or None


def _digests_of_names(data: Any, asked_by_all: Collection[str] = ()) -> list[str]:
    """Digests of the code of others that plain data names, wherever in it, and of the groups `asked_by_all`."""
    names = dict.fromkeys(_texts(data))
    groups = sorted(group for group in entry_points().groups if group.startswith(_GROUPS))
    installed = [point for group in groups for point in entry_points(group=group)]
    points = [point for point in installed if point.name in names or point.group in asked_by_all]
    order = {name: number for number, name in enumerate(names)}
    points.sort(key=lambda point: (order.get(point.name, len(order)), point.group, point.name, point.value))
    digests = [plugin_digest(_found(point.load), point) for point in points]
    for top in dict.fromkeys(filter(None, map(_named_module, names))):
        found = {} if top in _NOT_THEIRS else _package(top, None)
        digests.append(digest_of(found) if found else None)
    return list(dict.fromkeys(digest for digest in digests if digest is not None))


def _texts(data: Any) -> Iterator[str]:
    """Every text in plain data, keys too."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for key, value in data.items():
            yield from _texts(key)
            yield from _texts(value)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _texts(value)


def _named_module(text: str) -> str | None:
    """Top-level name of the module in "module:name", or of a registered environment of that id."""
    match = _MODULE.fullmatch(text)
    if match is None and _ENVIRONMENT.fullmatch(text):
        from gymnasium.envs.registration import registry

        target = registry[text].entry_point if text in registry else None
        match = _MODULE.fullmatch(target) if isinstance(target, str) else None
        if callable(target):
            return _top(target.__module__)
    return None if match is None else match[1]


def _found(load: Callable[[], Any]) -> Any:
    """What is loaded; where that cannot be done, the reason, which is the result then."""
    try:
        return load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a stranger's module does at import
        return error_line(error)


def plugin_digest(factory: Callable[..., Any] | str, point: EntryPoint | None = None) -> str | None:
    """SHA-256 of the code that defines a filter, a policy or a source; None where all of it is ours.

    Parameters
    ----------
    factory : callable or str
        A class, a function, a method or a partial of one; or why it cannot be loaded.
    point : EntryPoint, optional
        What names it, where it is a plug-in.
    """
    layers = [] if isinstance(factory, str) else list(_layers(factory))
    modules = [*([point.module] if point else []), *(layer.__module__ for layer in layers)]
    if modules and all(_top(module) in PACKAGES for module in modules[: 1 + (point is not None)]):
        return None  # what ours are derived from are libraries
    found: dict[str, str] = {"": factory} if isinstance(factory, str) else {}
    for top in dict.fromkeys(map(_top, modules)):
        if top not in _NOT_THEIRS:
            found |= _package(top, point.dist if point else None) or _without_file(top, layers)
    return digest_of(found) if found else None


def _top(module: str) -> str:
    return module.partition(".")[0]


def _layers(factory: Callable[..., Any] | None) -> Iterator[Any]:
    """What a factory is made of: its class and those that it is derived from, or its function."""
    while isinstance(factory, partial):
        factory = factory.func
    if inspect.isclass(factory):
        yield from inspect.getmro(factory)
    elif inspect.isfunction(factory):
        yield inspect.unwrap(factory)
    elif inspect.ismethod(factory):
        yield from _layers(factory.__func__)
        yield from _layers(factory.__self__ if inspect.isclass(factory.__self__) else type(factory.__self__))
    elif factory is not None:
        yield from inspect.getmro(type(factory))


# ---- code in files ---------------------------------------------------------------------------------------------------


def _package(top: str, known: Distribution | None) -> dict[str, str]:
    """Digests of the files behind a top-level name, by their paths; nothing where there are none."""
    beside = _place(top)
    if beside is None:
        return {}
    if beside.resolve() not in _INSTALLED:
        return _project(top, beside)
    owners = [known] if known else [Distribution.from_name(name) for name in packages_distributions().get(top, ())]
    records = {f"{one.name}-{one.version}": _digest((one.read_text("RECORD") or "").encode()) for one in owners}
    return records | _digests(top, beside)


def _place(top: str) -> Path | None:
    """The folder that a top-level module or package lies in; None where it has no file."""
    if top == "__main__":
        file = getattr(sys.modules["__main__"], "__file__", None)
        return None if file is None or not Path(file).is_file() else Path(file).parent
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).parent
    return Path(spec.origin).parent if spec.origin and Path(spec.origin).is_file() else None


def _project(top: str, beside: Path) -> dict[str, str]:
    """Code of a package or script of the user's, and of those in the same folder that it imports."""
    digests: dict[str, str] = {}
    waiting, seen = [top], {top}
    while waiting:
        name = waiting.pop()
        digests |= _digests(name, beside)
        for path in _code_of(name, beside):
            imported = _imported(path.read_bytes()) - seen - _NOT_THEIRS
            seen |= imported
            waiting += sorted(imported)
    return digests


def _digests(top: str, beside: Path) -> dict[str, str]:
    return {path.relative_to(beside).as_posix(): _digest(path.read_bytes()) for path in _code_of(top, beside)}


def _code_of(top: str, beside: Path) -> list[Path]:
    """Files with the code of a top-level module or package in a folder; none where it is not there."""
    if top == "__main__":
        return [Path(str(sys.modules["__main__"].__file__))]
    files = source_files(beside / top) if (beside / top).is_dir() else []
    alone = (beside / f"{top}{suffix}" for suffix in _CODE)
    return [*(path for path in files if path.name.endswith(_CODE)), *(path for path in alone if path.is_file())]


@lru_cache(maxsize=4096)
def _imported(content: bytes) -> frozenset[str]:
    """Top-level names of what a file of Python imports by statements, wherever in it; none of other files."""
    try:
        nodes = list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError, RecursionError):
        return frozenset()
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level]
    return frozenset(_top(name) for name in names if name)


# ---- code without files ----------------------------------------------------------------------------------------------

_PLAIN = (bool, int, float, complex, str, bytes, type(None))
_OF_PYTHON = {"__dict__", "__weakref__", "__doc__", "__module__", "__firstlineno__", "__static_attributes__"}
_OF_PYTHON |= {"__abstractmethods__", "_abc_impl"}
"""Attributes of classes that say nothing of what they do."""


def _without_file(module: str, layers: list[Any]) -> dict[str, str]:
    """Digest of what a module without a file, such as that of a notebook, says of these classes and functions."""
    facts: list[str] = []
    visited: dict[int, object] = {}  # kept, so that no id is given twice

    def say(value: Any) -> None:
        if isinstance(value, _PLAIN):
            facts.append(repr(value))
            return
        if id(value) in visited:
            return
        visited[id(value)] = value
        if isinstance(value, np.ndarray):
            facts.append(f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
        elif isinstance(value, types.CodeType):
            facts.append(f"{value.co_code!r} {value.co_names} {value.co_varnames}")
            say(value.co_consts)
        elif isinstance(value, property):
            say([value.fget, value.fset, value.fdel])
        elif isinstance(value, tuple | list):
            for item in value:
                say(item)
        elif isinstance(value, set | frozenset):
            say(sorted(map(repr, value)))
        elif isinstance(value, dict):
            say([part for key in sorted(value, key=repr) for part in (repr(key), value[key])])
        elif getattr(value, "__module__", None) != module:
            named = value if hasattr(value, "__qualname__") else type(value)
            facts.append(f"{named.__module__}.{named.__qualname__}")
        elif inspect.isclass(value):
            say([value.__qualname__, *value.__bases__])
            say({name: member for name, member in vars(value).items() if name not in _OF_PYTHON})
        elif inspect.isfunction(value):
            say([value.__code__, value.__defaults__, value.__kwdefaults__])
            say([cell.cell_contents for cell in value.__closure__ or ()])
            if value.__globals__.get("__name__") == module:
                say([value.__globals__[name] for name in _names(value.__code__) if name in value.__globals__])
        else:
            say([type(value), getattr(value, "__dict__", {})])

    say([layer for layer in layers if layer.__module__ == module])
    return {module: hashlib.sha256("\n".join(facts).encode()).hexdigest()}


def _names(code: types.CodeType) -> list[str]:
    """Names that a function uses, with those of the functions in it."""
    inner = [name for item in code.co_consts if isinstance(item, types.CodeType) for name in _names(item)]
    return sorted({*code.co_names, *inner})
