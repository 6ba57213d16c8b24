"""One process at a time writes into a folder; full and read-only disks are told in a line (15 s)."""

import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.benchmark.storage.run_files import load_run
from stereo_slam_env.cli import app as cli
from stereo_slam_env.files.folders import CLAIM, claimed_folder, is_occupied, unfinished_name

ROOT = Path(__file__).resolve().parents[3]
BENCH = ("bench", "--preset", "reference-turn", "--seeds", "2", "--frames", "4", "--jobs", "1")
SPAWN = multiprocessing.get_context("spawn")
LIMIT = 60.0


@pytest.fixture
def command(capsys, monkeypatch):
    """Run the command with a report that costs no time: exit code and the lines on stderr."""

    def write_report(out, *_, **__):
        (out / "report.html").write_text("a report")
        return out / "report.html"

    monkeypatch.setattr("stereo_slam_env.report.benchmark_report.write_report", write_report)

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        return code, capsys.readouterr().err.splitlines()

    return run


@contextmanager
def small_disk(folder, options):
    """A file system of its own; skips where this user may not mount one."""
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip(f"needs the right to mount: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def in_another_process(work, *arguments):
    """Start it, and wait for the word that it is at work."""
    here, there = SPAWN.Pipe()
    process = SPAWN.Process(target=work, args=(there, *arguments))
    process.start()
    assert here.poll(LIMIT)
    assert here.recv() == "at work"
    return process, here


def hold(told, folder):
    with claimed_folder(folder):
        told.send("at work")
        told.poll(LIMIT)


def count_up(folder, times):
    """Add one at a time to a number in a file, the way that loses counts where two do it at once."""
    done = 0
    while done < times:
        try:
            with claimed_folder(folder):
                file = folder / "count"
                number = int(file.read_text()) if file.exists() else 0
                time.sleep(0.001)
                file.write_text(str(number + 1))
                done += 1
        except ValueError:
            time.sleep(0.001)


def pages(path):
    """What a file takes of a tmpfs."""
    return -(-path.stat().st_size // resource.getpagesize())


def trials(out):
    return {path.relative_to(out): load_run(path).run.positions for path in sorted(out.glob("trials/*/*.npz"))}


def test_a_folder_in_use_is_refused_until_its_owner_is_done(tmp_path):
    owner, told = in_another_process(hold, tmp_path / "run")
    with (
        pytest.raises(ValueError, match="in use by another process: wait until it ends, or choose another"),
        claimed_folder(tmp_path / "run"),
    ):
        pass
    told.send("enough")
    owner.join(LIMIT)
    with claimed_folder(tmp_path / "run"):
        assert not is_occupied(tmp_path / "run")
    assert [path.name for path in (tmp_path / "run").iterdir()] == [CLAIM]


def test_a_killed_owner_has_no_claim_and_leaves_nothing_half_written(tmp_path, monkeypatch):
    owner, _ = in_another_process(hold, tmp_path)
    os.kill(owner.pid, signal.SIGKILL)
    owner.join(LIMIT)
    (tmp_path / "trials").mkdir()
    monkeypatch.setattr(os, "getpid", lambda: owner.pid)
    for name, more in (("euclidean.npz", ""), ("trials.sqlite", "-journal")):
        Path(f"{unfinished_name(tmp_path / 'trials' / name)}{more}").write_bytes(b"half")
    with claimed_folder(tmp_path):
        assert list((tmp_path / "trials").iterdir()) == []


def test_of_many_at_once_one_works_at_a_time(tmp_path):
    workers = [SPAWN.Process(target=count_up, args=(tmp_path, 25)) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert (tmp_path / "count").read_text() == "100"


def test_a_second_run_in_a_folder_is_refused_in_a_line_and_harms_nothing(command, tmp_path):
    out = tmp_path / "run"
    arguments = [*BENCH[:3], "--seeds", "1", "--frames", "40", "--jobs", "1", "--out", str(out)]
    arguments += ["--filters", "euclidean"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    first = subprocess.Popen([sys.executable, "-m", "stereo_slam_env", *arguments], env=environment, text=True,
                             stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)  # fmt: skip
    while not (out / "study.json").exists():
        assert first.poll() is None, first.communicate()[1]
        time.sleep(0.01)
    os.kill(first.pid, signal.SIGSTOP)  # it stays where it is while the second one tries
    try:
        code, lines = command(*arguments)
    finally:
        os.kill(first.pid, signal.SIGCONT)
    assert code == 2
    assert lines[-1].startswith(f"error: output {out} is in use by another process: ")
    _, err = first.communicate(timeout=120)
    assert first.returncode == 0, err
    assert command(*arguments)[0] == 0
    assert len(trials(out)) == 1


def test_a_full_disk_keeps_what_is_finished_and_the_same_command_goes_on(command, tmp_path):
    assert command(*BENCH, "--out", tmp_path / "undisturbed")[0] == 0
    expected = trials(tmp_path / "undisturbed")
    out = tmp_path / "undisturbed"
    before_trials = [out / "study.json", out / "settings.json", *out.glob("recordings/**/*.*")]
    room = sum(map(pages, [*before_trials, *list(out.glob("trials/**/*.npz"))[:3]]))
    with small_disk(tmp_path / "disk", f"nr_blocks={room}") as disk:
        code, lines = command(*BENCH, "--out", disk / "run")
        kept = trials(disk / "run")
        assert code == 2
        assert f"the disk is full: {len(kept)} finished trials are kept in {disk / 'run'}" in lines[-1]
        assert 0 < len(kept) < len(expected)
        assert not list(disk.rglob("*.part"))
        subprocess.run(["mount", "-o", "remount,size=100m", disk], check=True)
        assert command(*BENCH, "--out", disk / "run")[0] == 0
        found = trials(disk / "run")
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[name], expected[name]) for name in expected)


def test_a_read_only_folder_is_told_in_a_line(command, tmp_path):
    with small_disk(tmp_path / "disk", "ro") as disk:
        for out in (disk, disk / "new"):
            code, lines = command(*BENCH, "--out", out)
            assert code == 2
            assert lines[-1] == (
                f"error: output {out} cannot be written (Read-only file system): choose another directory"
            )


def test_a_folder_without_permission_is_told_as_well(monkeypatch, tmp_path):
    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    with (
        pytest.raises(OSError, match=r"cannot be written \(Permission denied\): choose another"),
        claimed_folder(tmp_path),
    ):
        pass
