"""Every test has a limit, whoever waits for whatever (4 s)."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

IN_PYTHON = """
import threading
def test_that_hangs():
    threading.Event().wait()
"""
IN_C = """
import ctypes
def test_that_hangs():
    c, mutex = ctypes.PyDLL(None), ctypes.create_string_buffer(64)  # calls of a PyDLL keep the interpreter's lock
    c.pthread_mutex_lock(mutex)
    c.pthread_mutex_lock(mutex)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the names of the C library are those of Linux")
@pytest.mark.parametrize(
    ("body", "sign"), [(IN_PYTHON, "Failed: Timeout"), (IN_C, "Timeout (0:00:02)!")], ids=["in Python", "in C"]
)
def test_a_test_that_hangs_is_ended_and_shows_where(tmp_path, body, sign):
    (tmp_path / "test_it.py").write_text(body)
    settings = ("-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, "-o", "timeout=1", "-o", "faulthandler_timeout=2")
    command = [sys.executable, "-m", "pytest", *settings, tmp_path]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    output = done.stdout + done.stderr
    assert done.returncode == 1, output
    assert sign in output
    assert "that_hangs" in output


def test_the_limit_comes_before_the_end_of_the_process(pytestconfig):
    assert 0 < float(pytestconfig.getini("timeout")) < float(pytestconfig.getini("faulthandler_timeout"))
