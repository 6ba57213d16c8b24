"""Every reader of files that somebody else made: pipes, sockets, devices, folders, giants and links out (20 s)."""

from __future__ import annotations

import ast
import os
import time
from pathlib import Path

import pytest

from fuzz.harness import DEVICE, FOLDER, LINK, PIPE, SOCKET, SPARSE, Harness, limited_memory, make_special
from fuzz.targets import targets
from stereo_slam_env.files.opening import NotOpened, open_regular, read_bytes

ROOT = Path(__file__).resolve().parents[3]
HOW = {"pipe": PIPE, "socket": SOCKET, "device": DEVICE, "folder": FOLDER, "giant": SPARSE, "link out": LINK}
MOST_SECONDS = 3.0
NOT_READ = {
    "2011_09_26/2011_09_26_drive_0005_sync/image_01/timestamps.txt",  # both cameras are triggered at once
    "called.toml",  # it is refused as it is
    "source.json",  # where it cannot be read it is somebody else's, and passed over
}


def of_each_kind(names):
    """All but images and packets, which are many: one of each folder."""
    many = (".png", ".jpg")
    key = {name: Path(name).parent if name.endswith(many) or "/data/" in name else name for name in names}
    return list({key[name]: name for name in names}.values())


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_what_is_no_file_is_refused_in_a_line_by_every_reader(target, how, tmp_path):
    if how == "link out" and target.follows_links:
        pytest.skip("the file itself is named by the user")
    harness = Harness((target,), tmp_path)
    for name in of_each_kind(set(target.files) - NOT_READ):
        began = time.monotonic()
        with (
            harness.changed(0, name, HOW[how]) as waited,
            limited_memory(),
            pytest.raises(ValueError, match=r"\A[^\n]+\Z") as refused,
        ):
            target.read(harness.folders[0])
        assert not waited, name
        assert time.monotonic() - began < MOST_SECONDS, name
        assert Path(name).stem.lstrip("0") in str(refused.value) or "frame 2" in str(refused.value), name


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (PIPE, "is no regular file but a pipe"),
        (SOCKET, "is no regular file but a socket"),
        (DEVICE, "is no regular file but a device"),
        (SPARSE, "more than 2000000000 are refused"),
    ],
)
def test_what_it_is_is_said(how, words, tmp_path):
    make_special(tmp_path / "x", how)
    with pytest.raises(NotOpened, match=words):
        open_regular(tmp_path / "x")


def test_a_folder_and_a_missing_file_and_a_forbidden_one_are_told_apart(tmp_path):
    with pytest.raises(NotOpened, match="is no regular file but a folder"):
        open_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "nothing")
    with pytest.raises(NotOpened, match="cannot be read"):
        open_regular(tmp_path / "a\0b")
    (tmp_path / "file").write_bytes(b"12345")
    with pytest.raises(NotOpened, match=r"cannot be read \(Not a directory\)"):
        open_regular(tmp_path / "file" / "below")


def test_a_file_is_read_whole_within_its_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    assert read_bytes(tmp_path / "file", most_bytes=5) == b"12345"
    with pytest.raises(NotOpened, match="has 5 bytes: more than 4 are refused") as caught:
        read_bytes(tmp_path / "file", most_bytes=4)
    assert caught.value.too_large


def test_links_are_followed_inside_a_folder_alone(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "file").write_bytes(b"in")
    (tmp_path / "out").write_bytes(b"out")
    (tmp_path / "in" / "near").symlink_to("file")
    (tmp_path / "in" / "far").symlink_to(tmp_path / "out")
    (tmp_path / "named").symlink_to("in")
    for folder in (tmp_path / "in", tmp_path / "named"):
        assert read_bytes(folder / "near", inside=folder) == b"in"
        with pytest.raises(ValueError, match="is a link out of its folder"):
            read_bytes(folder / "far", inside=folder)
    assert read_bytes(tmp_path / "in" / "far") == b"out"


def test_a_file_that_becomes_a_pipe_is_not_waited_for(tmp_path, monkeypatch):
    """What was looked at and what is opened need not be the same file."""
    path = tmp_path / "file"
    path.write_bytes(b"x")
    honest = os.open

    def swapped(where, flags, *more, **named):
        if where == path:
            path.unlink()
            os.mkfifo(path)
        return honest(where, flags, *more, **named)

    monkeypatch.setattr(os, "open", swapped)
    with pytest.raises(NotOpened, match="a pipe"):
        open_regular(path)


# --- there is no other way ------------------------------------------------------------------------------------------

MODULES = sorted(path for folder in ("filters", "stereo_slam_env") for path in (ROOT / folder).rglob("*.py"))
OPENING = {"open", "read_text", "read_bytes", "fdopen"}
FOREIGN = {
    *("np.load", "np.loadtxt", "np.genfromtxt", "np.fromfile", "np.memmap", "cv2.imread", "cv2.VideoCapture"),
    *("cv2.FileStorage", "Image.open", "json.load", "tomllib.load", "torch.load", "sqlite3.connect"),
    *("zipfile.ZipFile", "zipfile.Path", "io.open", "gzip.open", "tarfile.open", "h5py.File", "pd.read_csv"),
    *(
        "yaml.load",
        "yaml.safe_load",
        "yaml.parse",
        "YAML",
        "tomllib.loads",
        "ElementTree.parse",
        "AnyReader",
        "bz2.open",
    ),
}
OWN = {
    "stereo_slam_env/__init__.py": {"ours.read_bytes": "the package's own source"},
    "stereo_slam_env/files/opening.py": {"os.open": "this is it", "os.fdopen": "this is it"},
    "stereo_slam_env/files/yaml_files.py": {"yaml.parse": "this is it"},
    "stereo_slam_env/files/bags.py": {
        "AnyReader": "this is it",
        "sqlite3.connect": "of a file that has been opened, for reading",
        "zstandard().open": "of a file that has been opened",
    },
    "stereo_slam_env/files/readers.py": {
        "tomllib.loads": "this is it",
        "np.loadtxt": "of a text that has been read",
        "zipfile.ZipFile": "of a file that has been opened",
        "archive.open": "a part of an archive that has been opened",
    },
    "stereo_slam_env/datasets/image_files.py": {"Image.open": "of bytes that have been read"},
    "stereo_slam_env/policies/ppo.py": {"torch.load": "of a file that has been opened, without pickles"},
    "stereo_slam_env/world/physics.py": {"os.open": "the null device"},
    "stereo_slam_env/report/page.py": {
        "files(__package__).joinpath(name).read_text": "a file of the package",
        "_KEPT_LIBRARY.read_text": "a file that the package wrote beside itself",
    },
    "stereo_slam_env/benchmark/running/isolation.py": {"open": "ends of pipes, by their number"},
    "stereo_slam_env/benchmark/running/process_server.py": {"children.read_text": "a file of /proc"},
    "filters/kernels/compilation.py": {"Path(path).read_bytes": "the project's own source"},
    "stereo_slam_env/benchmark/scenarios/schema.py": {"files(__package__).joinpath(NAME).read_bytes": "of the package"},
    "stereo_slam_env/benchmark/scenarios/study.py": {"_PRESETS.read_text": "a file of the package"},
    "stereo_slam_env/benchmark/statistics/sentences.py": {
        "files(__package__).joinpath('sentences.jinja').read_text": "a file of the package"
    },
    "stereo_slam_env/benchmark/storage/code_identity.py": {
        "one.read_text": "a list of files of an installed package",
        "path.read_bytes": "the package's own source, or code that runs here anyway",
    },
    "stereo_slam_env/benchmark/storage/result_tables.py": {"sqlite3.connect": "a new file, to write it"},
    "stereo_slam_env/datasets/bag_writer.py": {"self._writer.open": "a new bag, to write it"},
    "stereo_slam_env/datasets/settings_files.py": {
        "files(__package__).joinpath(name).read_text": "a file of the package"
    },
    "stereo_slam_env/paper/paper_claims.py": {
        "Path(__file__).with_name('claims.json').read_text": "a file of the package"
    },
}


def openings(source: str) -> set[str]:
    """Calls that open files for reading, as they are written."""
    found = set()
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func).replace("numpy.", "np.")
        last = name.rpartition(".")[2]
        is_ours = name == "read_bytes"  # of `files.opening`; that of a path has one before it
        writes = any(
            isinstance(word, ast.Constant) and isinstance(word.value, str) and set(word.value) & set("wax")
            for word in (*call.args, *(keyword.value for keyword in call.keywords if keyword.arg == "mode"))
        )
        if name in FOREIGN or (last in OPENING and not is_ours and not (last == "open" and writes)):
            found.add(name)
    return found - {"read_text"}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files_are_opened_in_one_place(path):
    assert openings(path.read_text(encoding="utf-8")) <= set(OWN.get(path.relative_to(ROOT).as_posix(), ()))


def test_reading_takes_the_memory_of_the_file_and_not_of_its_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"x")
    with limited_memory():
        assert read_bytes(tmp_path / "file") == b"x"
