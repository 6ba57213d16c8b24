"""What is written is there complete, or as it was; nothing that somebody else made is removed or replaced (10 s)."""

import ast
import json
from pathlib import Path

import pytest

from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.store import prepared_study, root_of
from stereo_slam_env.cli import app as cli
from stereo_slam_env.files.folders import (
    CLAIM,
    LIST,
    claimed_folder,
    is_occupied,
    own_files,
    remove_own_files,
    unfinished_name,
    write_atomically,
    write_text,
)
from stereo_slam_env.report.charts.drawing import Chart
from stereo_slam_env.report.page import clean_figures, figure_block, write_page

ROOT = Path(__file__).resolve().parents[3]
BENCH = (
    "bench",
    "--preset",
    "reference-turn",
    "--filters",
    "euclidean",
    "--seeds",
    "1",
    "--frames",
    "4",
    "--jobs",
    "1",
)
STRANGE = (
    *(".thesis.part", ".thesis.tex.part~", ".thesis.12.part", ".notes.12.0123456789abcdef.part", "chapter.partial"),
    *("cells/.draft.part", "cells/old/.draft.1.part-journal", "figures/accuracy.png", "figures/own.svg"),
    *("tables/pairs.tex", "report.html", "comparison.html", "score.json", "summary.json", "run.json", "faults.md"),
    *("learning_curve.csv", "trials/seed-0000/euclidean.npz", "recordings/drive.npz", "claims.csv"),
)
"""Files of a stranger, with names that this program gives and names that look like those of unfinished files."""


def one(name="one", **changes):
    return Scenario(name, ReferenceSource("short_turn"), (FilterChoice("paper", "inverse-depth"),), **changes)


@pytest.fixture
def stranger(tmp_path):
    """A folder of somebody else, and the content of every file in it."""
    folder = tmp_path / "stranger"
    for name in STRANGE:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"mine: {name}")
    return folder


def content(folder, names=STRANGE):
    return {name: (folder / name).read_text() for name in names if (folder / name).exists()}


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def fails(stream):
        stream.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, fails)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "theirs").write_text("mine")
    (tmp_path / "file").symlink_to("theirs")
    unfinished_name(tmp_path / "file").symlink_to("theirs")
    write_text(tmp_path / "file", "ours")
    assert (tmp_path / "theirs").read_text() == "mine"
    assert (tmp_path / "file").read_text() == "ours"
    assert not (tmp_path / "file").is_symlink()


def test_a_long_name_can_be_written(tmp_path):
    write_text(tmp_path / ("x" * 250), "x")
    assert [path.name for path in tmp_path.iterdir()] == ["x" * 250]


def test_what_is_swept_is_ours_alone(stranger):
    unfinished_name(stranger / "cells" / "a.npz").write_text("half")
    Path(f"{unfinished_name(stranger / 'trials.sqlite')}-journal").write_text("half")
    unfinished_name(stranger / "folder").mkdir()
    before = content(stranger)
    with claimed_folder(stranger):
        assert content(stranger) == before
        left = [path.name for path in stranger.rglob(".*") if path.is_file() and path.name not in (CLAIM,)]
        assert sorted(left) == sorted(Path(name).name for name in STRANGE if Path(name).name.startswith("."))


def test_what_another_process_writes_below_is_left(tmp_path):
    (tmp_path / "other").mkdir()
    half = unfinished_name(tmp_path / "other" / "a.npz")
    with claimed_folder(tmp_path / "other"):
        half.write_text("half")
        with claimed_folder(tmp_path):
            assert half.exists()


@pytest.mark.parametrize("make", [lambda p: p.write_text("pid 7"), lambda p: p.symlink_to("theirs"), Path.mkdir])
def test_a_lock_that_is_not_ours_is_not_emptied(make, tmp_path):
    (tmp_path / "theirs").write_text("mine")
    (tmp_path / "run").mkdir()
    make(tmp_path / "run" / CLAIM)
    before = (tmp_path / "run" / CLAIM).lstat()
    with (
        pytest.raises(ValueError, match=r"has a \.lock that is not ours: choose another"),
        claimed_folder(tmp_path / "run"),
    ):
        pass
    assert is_occupied(tmp_path / "run")
    assert (tmp_path / "run" / CLAIM).lstat() == before
    assert (tmp_path / "theirs").read_text() == "mine"


# ---- runs ------------------------------------------------------------------------------------------------------------


def test_a_cell_is_one_that_the_study_around_it_names(tmp_path):
    study = Study.of(one())
    assert root_of(tmp_path / "cells" / "one") == tmp_path / "cells" / "one"
    (tmp_path / "study.json").write_text(json.dumps({"cells": [{"name": "two"}, 3]}))
    assert root_of(tmp_path / "cells" / "one") == tmp_path / "cells" / "one"
    (tmp_path / "study.json").write_text(json.dumps({"cells": [{"name": "one"}]}))
    assert root_of(tmp_path / "cells" / "one") == tmp_path
    assert prepared_study(tmp_path / "cells" / "one", study).root == tmp_path


def test_a_cell_is_known_from_inside_its_grid(tmp_path, monkeypatch):
    (tmp_path / "cells").mkdir()
    (tmp_path / "study.json").write_text(json.dumps({"cells": [{"name": "one"}]}))
    monkeypatch.chdir(tmp_path / "cells")
    assert root_of(Path("one")) == tmp_path
    monkeypatch.chdir(tmp_path)
    assert root_of(Path("cells/one")) == Path()


def test_a_run_in_a_folder_called_cells_keeps_what_is_around_it(stranger, capsys):
    before = content(stranger)
    assert cli.main([*BENCH, "--out", str(stranger / "cells" / "mine")]) == 0, capsys.readouterr().err
    assert content(stranger) == before
    assert not (stranger / CLAIM).exists()
    assert (stranger / "cells" / "mine" / "recordings").is_dir()


@pytest.mark.parametrize(
    "settings", ['{"editor.fontSize": 12}', '{"version": 1, "settings": {}, "versions": {}}', "[]", '{"scenario": 3}']
)
def test_settings_of_other_programs_are_no_run(settings, stranger, capsys):
    (stranger / "settings.json").write_text(settings)
    before = content(stranger, (*STRANGE, "settings.json"))
    for study in (Study.of(one()), Study("two", (*Study.of(one()).cells, *Study.of(one("two")).cells))):
        with pytest.raises(ValueError, match="is not empty and holds no run"):
            prepared_study(stranger, study).write_settings()
    if "versions" not in settings:
        assert cli.main(["paper", "--quick", "--out", str(stranger)]) == 2
    assert content(stranger, (*STRANGE, "settings.json")) == before
    assert not (stranger / CLAIM).exists()


@pytest.mark.parametrize("command", [("report",), ("submit",)])
def test_a_folder_that_is_no_run_is_not_walked(command, stranger, capsys):
    (stranger / "env").symlink_to("/usr")
    assert cli.main([*command, str(stranger)]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_a_link_of_the_user_in_a_run_is_left_alone(tmp_path, capsys):
    prepared_study(tmp_path / "run", Study.of(one())).write_settings()
    (tmp_path / "run" / "env").mkdir()
    (tmp_path / "run" / "env" / "lib").symlink_to("/usr")
    assert cli.main(["submit", str(tmp_path / "run"), "--out", str(tmp_path / "p.json")]) == 2
    assert "the run is not finished" in capsys.readouterr().err
    (tmp_path / "run" / "trials").symlink_to("/usr")
    assert cli.main(["submit", str(tmp_path / "run"), "--out", str(tmp_path / "p.json")]) == 2
    assert "is a link out of its folder" in capsys.readouterr().err


# ---- reports in folders that may hold anything -----------------------------------------------------------------------

CHART = Chart({"data": {"values": [{"x": 1}]}, "mark": "point", "encoding": {"x": {"field": "x"}}})


def test_a_report_replaces_its_own_files_and_no_others(tmp_path):
    for name in ("first", "second"):
        folder = clean_figures(tmp_path)
        figure_block(CHART, name, "A figure.", folder)
        write_page(tmp_path / "report.html", title="a", subtitle="b", contents=[])
        (tmp_path / "figures" / f"own-{name}.png").write_text("mine")
    left = {"own-first.png", "own-second.png", "second.png", "second.svg"}
    assert {path.name for path in folder.iterdir()} == left
    (tmp_path / "figures" / "first.png").write_text("mine")
    with pytest.raises(ValueError, match=r"first\.png is there and is not ours"):
        figure_block(CHART, "first", "A figure.", clean_figures(tmp_path))
    assert (tmp_path / "figures" / "first.png").read_text() == "mine"


def test_a_report_in_the_folder_of_a_stranger_is_refused(stranger):
    before = content(stranger)
    with pytest.raises(ValueError, match=r"report\.html is there and is not ours"):
        clean_figures(stranger)
    assert content(stranger) == before


@pytest.mark.parametrize("name", ["../theirs", "figures/../../theirs", "theirs", "figures/a/theirs", "/theirs"])
def test_a_list_of_a_stranger_removes_nothing_elsewhere(name, tmp_path):
    run = tmp_path / "run"
    for path in (tmp_path / "theirs", run / "theirs", run / "figures" / "a" / "theirs"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    (run / LIST).write_text(json.dumps({"run": False, "files": [name]}))
    remove_own_files(run, ("figures", "tables"))
    assert len(list(tmp_path.rglob("theirs"))) == 3


def test_figures_are_not_removed_through_a_link(stranger, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "figures").symlink_to(stranger / "figures")
    (out / LIST).write_text(json.dumps({"run": True, "files": ["figures/accuracy.png"]}))
    before = content(stranger)
    remove_own_files(out, ("figures",))
    with pytest.raises(ValueError, match="is a link out of its folder"):
        own_files(out, ["figures/own.svg"])
    assert content(stranger) == before


@pytest.mark.parametrize("text", ["[]", '{"files": 3}', "x", '{"files": []}'])
def test_another_list_is_refused(text, tmp_path):
    (tmp_path / LIST).write_text(text)
    with pytest.raises(ValueError, match="is no list of files of this program"):
        own_files(tmp_path, ["a"])


@pytest.mark.parametrize("name", ["score.json", "report.html", "figures/path.png"])
def test_evaluate_leaves_the_files_of_others(name, tmp_path, capsys):
    lines = [f"{k} 0 0 {k} 0 0 0 1" for k in range(30)]
    (tmp_path / "a.tum").write_text("\n".join(lines))
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    arguments = ["evaluate", str(tmp_path / "a.tum"), str(tmp_path / "a.tum"), "--out", str(tmp_path / "out")]
    assert cli.main(arguments) == 2
    assert "is there and is not ours" in capsys.readouterr().err
    assert path.read_text() == "mine"
    path.unlink()
    assert [cli.main(arguments), cli.main(arguments)] == [0, 0]


def test_submit_replaces_packets_alone(tmp_path, monkeypatch, capsys):
    assert cli.main([*BENCH, "--out", str(tmp_path / "package")]) == 0
    monkeypatch.chdir(tmp_path)
    (tmp_path / "package.json").write_text('{"name": "mine"}')
    assert cli.main(["submit", "package"]) == 2
    assert "package.json is there and is no packet" in capsys.readouterr().err
    assert (tmp_path / "package.json").read_text() == '{"name": "mine"}'
    assert [cli.main(["submit", "package", "--out", "p.json"]) for _ in range(2)] == [0, 0]


# ---- there is no other way -------------------------------------------------------------------------------------------

CHANGES = {"unlink", "rmtree", "rmdir", "rename", "write_text", "write_bytes", "touch", "truncate", "imwrite"}
CHANGES |= {f"os.{name}" for name in ("replace", "remove", "truncate")} | {"shutil.move", "sqlite3.connect", "np.save"}
WHY = {
    "stereo_slam_env/files/folders.py": "this is the place",
    "stereo_slam_env/files/bags.py": "files unpacked into a temporary folder",
    "stereo_slam_env/benchmark/storage/result_tables.py": "an unfinished file of ours, with SQLite's journal",
    "stereo_slam_env/benchmark/storage/store.py": "recordings and bounds in a run of ours, by their names",
    "stereo_slam_env/benchmark/running/isolation.py": "an end of a pipe, by its number",
    "stereo_slam_env/viewer/watched_drive.py": "an unfinished file of ours, and the file that was asked for",
    "stereo_slam_env/world/physics.py": "a folder of our own for temporary files, which must not exist before",
    "stereo_slam_env/datasets/writing.py": "a new folder, claimed, and an empty one; what is there is refused",
    **{
        f"stereo_slam_env/datasets/{name}.py": "in the folder of an unfinished drive of ours, claimed by `writing`"
        for name in ("kitti_odometry", "asl_writer", "bag_writer", "written_frame")
    },
}
"""Files of the packages that change files themselves, and why they can change none of a stranger."""


def changing(source):
    """Calls that remove, replace or write files."""
    found = set()
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func)
        last = name.rpartition(".")[2]
        words = [a.value for a in (*call.args, *(k.value for k in call.keywords)) if isinstance(a, ast.Constant)]
        words = words if last in ("open", "fdopen") else []
        if any(isinstance(word, str) and len(word) < 4 and set(word) & set("wax+") for word in words):
            found.add(name)
        # `replace` of a path has one argument, that of a text two, and `dataclasses.replace` no object before it.
        of_path = last == "replace" and "." in name and len(call.args) == 1 and not call.keywords
        if name in CHANGES - {"write_text"} or ("." in name and last in CHANGES) or of_path:
            found.add(name)
    return found


@pytest.mark.parametrize("room", ["filters", "stereo_slam_env"])
def test_files_are_changed_in_one_place(room):
    paths = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / room).rglob("*.py")}
    assert {name for name, path in paths.items() if changing(path.read_text())} == {
        n for n in WHY if n.startswith(room)
    }
