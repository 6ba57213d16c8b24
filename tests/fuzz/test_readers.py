"""Every public reader stands on the list of `fuzz.targets`, and every one on it stands bombs and limits (1 min)."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import sys
import time
from pathlib import Path

import pytest

import filters
import stereo_slam_env
from fuzz.bombs import bombs
from fuzz.harness import RAW, Harness, limited_memory
from fuzz.targets import Target, targets
from stereo_slam_env.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
MOST_SECONDS = 4.0
"""of processor time; on an idle machine none takes a second."""

# ---- the list is whole -----------------------------------------------------------------------------------------------

OPENERS = {
    *("open_regular", "require_regular", "read_bytes", "read_text", "read_json", "read_table", "read_poses"),
    *("read_archive", "read_arrays", "parse_yaml", "parse_toml", "open_bag"),
}
"""The only functions that open files of others (`test_foreign_files.py`)."""
NOT_ON_IT = {
    "benchmark/scenarios/study.py _presets": "a file of the package",
    "cli/shared_options.py _table": "the command line",
    "cli/shared_options.py settings_from": "the command line",
    "datasets/writing.py _is_of": "what a writing of its own left, which another one is held against",
    "paper/__init__.py _kept": "its own results: what is wrong with one is that it is computed again",
    "policies/ppo.py _load_state": "needs a network, see tests/stereo_slam_env/policies/test_ppo.py",
    "benchmark/storage/code_identity.py _digest_of_files": "trajectories that are read before, as `layouts`",
    "benchmark/storage/store.py root_of": "a study that is read before, or no study of ours",
    "sensing/rig_files.py _png_size": "the size in the header of a picture, as `datasets.image_files` has it",
    "datasets/image_files.py _content": "of every layout of images",
}
"""Functions that call one of `OPENERS` and are reached by no target, with the reason."""
WRITERS = {
    *("BenchmarkResult", "write_recording", "DriftModel.write", "claimed_folder", "is_occupied"),
    *("own_files", "write_atomically", "write_text", "write_json", "save_recording", "save_trajectory", "Chart.save"),
    *("figure_block", "on_page", "write_trajectory_report", "save_film", "save_still", "RerunView"),
    *("search_film", "Recorder"),
}
"""Public names whose paths are only written."""
NO_FILES = {
    *("stereo-slam filters list", "stereo-slam filters check", "stereo-slam policies list", "stereo-slam warm-up"),
    *("stereo-slam scenes list", "stereo-slam scenes render", "stereo-slam scenes record"),
}
"""Commands that read no file but one that `--rig` names, as `rigs` does."""


def callers_of_openers() -> set[str]:
    """Every function of the packages that opens a file, as "module function"."""
    found = set()

    def look(module: str, node: ast.AST, name: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = f"{name}.{child.name}" if isinstance(child, ast.FunctionDef | ast.ClassDef) and name else name
            inner = child.name if isinstance(child, ast.FunctionDef | ast.ClassDef) and not name else inner
            if isinstance(child, ast.Call) and getattr(child.func, "id", None) in OPENERS:
                found.add(f"{module} {name}")
            look(module, child, inner)

    for path in (ROOT / "stereo_slam_env").rglob("*.py"):
        module = path.relative_to(ROOT / "stereo_slam_env").as_posix()
        if not module.startswith("files/"):
            look(module, ast.parse(path.read_text(encoding="utf-8")), "")
    return found


def reached(chosen: tuple[Target, ...], folder: Path) -> set[str]:
    """Functions that call an opener while the targets read their valid folders."""
    found = set()
    inside = str(ROOT / "stereo_slam_env") + "/"

    def watch(frame, event, _argument) -> None:
        if event == "call" and frame.f_code.co_name in OPENERS and "/files/" in frame.f_code.co_filename:
            caller = frame.f_back
            while caller is not None and "<" in caller.f_code.co_name:  # a comprehension in it
                caller = caller.f_back
            if caller is not None and caller.f_code.co_filename.startswith(inside):
                name = getattr(caller.f_code, "co_qualname", caller.f_code.co_name).replace(".<locals>", "")
                found.add(f"{caller.f_code.co_filename.removeprefix(inside)} {name.rpartition('.')[2]}")

    harness = Harness(chosen, folder)
    for number, target in enumerate(chosen):
        sys.setprofile(watch)
        try:
            target.read(harness.folders[number])
        finally:
            sys.setprofile(None)
    return found


def short(callers: set[str]) -> set[str]:
    """Module and function, without the class around it."""
    return {f"{module} {name.rpartition('.')[2]}" for module, name in (caller.split(" ") for caller in callers)}


def test_every_function_that_opens_a_file_is_reached_by_a_target(tmp_path):
    """What calls an opener, and is reached by no reader of the list, is a reader that is not on it."""
    wanted = short(callers_of_openers())
    assert wanted - reached(targets(), tmp_path) - set(NOT_ON_IT) == set()
    assert set(NOT_ON_IT) <= wanted, "an exception is left over"


def test_a_reader_that_is_taken_off_the_list_is_missed(tmp_path):
    fewer = tuple(target for target in targets() if target.name not in ("body", "stereo_folder"))
    missed = short(callers_of_openers()) - reached(fewer, tmp_path) - set(NOT_ON_IT)
    assert "evaluation/body_frames.py read_body" in missed


def public_readers() -> set[str]:
    """Public functions, classes and methods with an argument that is a path."""
    found = set()
    for root in (stereo_slam_env, filters):
        modules = [
            root.__name__,
            *(m.name for m in pkgutil.walk_packages(root.__path__, f"{root.__name__}.") if m.ispkg),
        ]
        for face in map(importlib.import_module, (name for name in modules if ".paper" not in name)):
            for name in getattr(face, "__all__", None) or ():
                thing = getattr(face, name)
                made = [thing] if callable(thing) else []
                if inspect.isclass(thing):
                    made += [getattr(thing, key) for key in vars(thing) if not key.startswith("_")]
                found |= {_name(one) for one in filter(callable, made) if takes_path(one)}
    return found


def _name(thing) -> str:
    thing = getattr(thing, "func", thing)
    return f"{thing.__module__.rpartition('.')[2]}.{thing.__qualname__}"


def takes_path(function) -> bool:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    names = {"path", "file", "folder", "checkpoint", "directory"}
    return any(
        re.search(r"\bPath\b", str(p.annotation))
        or (p.name in names and re.search(r"\b(str|Rig)\b", str(p.annotation)))
        for p in parameters
    )


def commands() -> set[str]:
    """Every command, by the words to type."""

    def below(node, words):
        for command in node.registered_commands:
            yield f"{words} {command.name or command.callback.__name__.replace('_', '-')}"
        for group in node.registered_groups:
            yield from below(group.typer_instance, f"{words} {group.name or group.typer_instance.info.name}")

    return set(below(app, "stereo-slam"))


def test_every_public_reader_and_command_is_on_the_list():
    listed = {call for target in targets() for call in target.calls} | WRITERS
    assert {name for name in public_readers() if not {name, name.partition(".")[2]} & listed} == set()
    assert commands() - listed - NO_FILES == set()


def test_what_is_listed_is_there():
    known = commands() | public_readers()
    listed = {call for target in targets() for call in target.calls} | WRITERS | NO_FILES
    assert listed - known - {name.partition(".")[2] for name in known} == set()


# ---- what is on it stands --------------------------------------------------------------------------------------------


def of_each_form(target: Target) -> list[str]:
    """One file of each folder and ending: images and packets are many."""
    return list({(Path(name).parent, Path(name).suffix): name for name in target.files}.values())


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_a_bomb_in_place_of_a_file_is_read_or_refused_in_a_line(target, tmp_path):
    harness = Harness((target,), tmp_path)
    for name in of_each_form(target):
        for title, content in bombs(name, target.files[name]):
            for _ in range(3):  # a shared machine may be five times as slow for a moment
                began = time.process_time()
                with harness.changed(0, name, RAW, content), limited_memory():
                    assert len(said(target, harness.folders[0]).splitlines()) < 2, (name, title)
                spent = time.process_time() - began
                if spent < MOST_SECONDS:
                    break
            assert spent < MOST_SECONDS, (name, title)


def said(target: Target, folder: Path) -> str:
    """The words of a refusal; none where the file is read."""
    try:
        target.read(folder)
    except ValueError as error:
        return str(error)
    return ""
