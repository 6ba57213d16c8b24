"""A process for each piece of work: answers, errors, crashes and hangs come back, and nothing is left (2 s)."""

import os
import signal
import time

import numpy as np
import pytest

from stereo_slam_env.benchmark.running.isolation import WorkDied, WorkTooSlow, run_isolated


def children():
    """Processes that this one has not yet taken leave of."""
    try:
        return os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return None


def test_the_answer_comes_back():
    assert run_isolated(lambda tell: (os.getpid(), np.arange(3).tolist()))[0] != os.getpid()
    assert children() is None


def test_signs_of_life_are_passed_on():
    def work(tell):
        for step in range(4):
            tell(step, 4)
        return "done"

    heard = []
    assert run_isolated(work, progress=lambda done, total: heard.append((done, total))) == "done"
    assert heard == [(0, 4), (1, 4), (2, 4), (3, 4)]


def test_an_error_is_raised_here():
    def work(tell):
        raise ValueError("sigma must be > 0")

    with pytest.raises(ValueError, match="sigma must be > 0"):
        run_isolated(work)
    assert children() is None


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda: os._exit(3), "ended with code 3"),
        (lambda: os.kill(os.getpid(), signal.SIGUSR1), "ended by SIGUSR1"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "ended by SIGKILL"),
    ],
)
def test_a_crash_is_told(end, words):
    with pytest.raises(WorkDied, match=words):
        run_isolated(lambda tell: end())
    assert children() is None


def test_who_asks_the_process_to_end_interrupts_the_run():
    with pytest.raises(KeyboardInterrupt):
        run_isolated(lambda tell: os.kill(os.getpid(), signal.SIGINT) or time.sleep(60))


def test_silence_is_ended_but_not_slowness():
    def slow(tell):
        for step in range(6):
            time.sleep(0.1)
            tell(step, 6)
        return "late"

    assert run_isolated(slow, silence_limit=0.5) == "late"
    began = time.monotonic()
    with pytest.raises(WorkTooSlow, match="no sign of life"):
        run_isolated(lambda tell: time.sleep(60), silence_limit=0.2)
    assert time.monotonic() - began < 5
    assert children() is None


def test_an_answer_that_cannot_be_sent_is_an_error():
    with pytest.raises(RuntimeError, match="the answer cannot be sent"):
        run_isolated(lambda tell: lambda: None)


def test_an_interruption_here_ends_the_work_there():
    def interrupt(done, total):
        raise KeyboardInterrupt

    def work(tell):
        tell(0, 1)
        time.sleep(60)

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_isolated(work, progress=interrupt)
    assert time.monotonic() - began < 5
    assert children() is None
