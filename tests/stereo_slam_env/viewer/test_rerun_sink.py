"""Where a recording goes: a viewer is reached, or one line says why not (10 s)."""

import socket
import subprocess
import sys
import time

import pytest

from stereo_slam_env.viewer import rerun_view
from stereo_slam_env.viewer.rerun_view import close_sink, open_sink, require_rerun

ADDRESS = "rerun+http://127.0.0.1:9876/proxy"


@pytest.fixture
def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def stream():
    return pytest.importorskip("rerun", reason="needs the extra viewer").RecordingStream("test")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"save": "x.rrd", "connect": ADDRESS}, "exclude each other"),
        ({"save": "x.txt"}, "must end in .rrd"),
        ({"save": "nowhere/x.rrd"}, "nowhere does not exist"),
        ({}, "no display"),
        ({"connect": ""}, "such as rerun"),
        ({"connect": "127.0.0.1:9876"}, "such as rerun"),
        ({"connect": "http://127.0.0.1:9876/proxy"}, "such as rerun"),
        ({"connect": "rerun+http://127.0.0.1/proxy"}, "such as rerun"),
        ({"connect": "rerun+http://127.0.0.1:9876/"}, "such as rerun"),
        ({"connect": "rerun+http://127.0.0.1:99999/proxy"}, "such as rerun"),
    ],
)
def test_wrong_use_is_refused_in_a_line(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "platform", "linux")
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    with pytest.raises(ValueError, match=message) as refusal:
        open_sink(None, None, **arguments)
    assert "\n" not in str(refusal.value)


def test_an_address_where_nobody_listens_is_said_at_once(free_port):
    with pytest.raises(ConnectionError, match=f"no viewer answers at rerun.*{free_port}/proxy .*: start one there"):
        open_sink(None, None, connect=f"rerun+http://127.0.0.1:{free_port}/proxy")


@pytest.mark.slow
def test_a_viewer_gets_what_is_shown(stream, free_port):
    """Rerun's own receiver: it ends well once a whole recording has arrived, and in failure if none comes."""
    import rerun

    command = [sys.executable, "-m", "rerun", "--test-receive", "--bind", "127.0.0.1", "--port", str(free_port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as receiver:
        try:
            wait_until_it_listens(free_port)
            open_sink(stream, rerun.blueprint.Blueprint(), connect=f"rerun+http://127.0.0.1:{free_port}/proxy")
            stream.log("a", rerun.Scalars([1.0]))
            close_sink(stream)
            said, _ = receiver.communicate(timeout=120)
        finally:
            receiver.kill()
    assert receiver.returncode == 0, said


def wait_until_it_listens(port, patience=60.0):
    end = time.monotonic() + patience
    while time.monotonic() < end:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise AssertionError(f"nothing listens on port {port} after {patience} s")


def test_the_viewer_of_this_python_is_opened_wherever_the_path_leads(stream, monkeypatch):
    asked = {}
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(rerun_view.require_rerun(), "spawn", lambda **options: asked.update(options))
    open_sink(stream, None)
    assert asked["recording"] is stream
    assert asked["executable_path"].startswith(rerun_view.sysconfig.get_path("scripts"))


def test_what_rerun_complains_of_is_one_line(stream, monkeypatch):
    def spawn(**_):
        raise RuntimeError("Failed to find the viewer.\n\n    You can install\n")

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(rerun_view.require_rerun(), "spawn", spawn)
    with pytest.raises(ConnectionError, match=r"^Rerun's viewer: Failed to find the viewer\.$"):
        open_sink(stream, None)


def test_without_rerun_the_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", None)
    with pytest.raises(ImportError, match=r' -m pip install "stereo-slam-env\[viewer\]"$'):
        require_rerun()
