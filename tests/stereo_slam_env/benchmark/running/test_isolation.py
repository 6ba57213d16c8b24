"""A process for each piece of work: answers, errors, crashes and hangs come back, and nothing is left (5 s)."""

import logging
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError
from contextlib import suppress

import numba
import numpy as np
import pytest

from stereo_slam_env.benchmark.running import isolation, process_server
from stereo_slam_env.benchmark.running.isolation import NoProcess, WorkDied, WorkTooSlow, run_isolated

from ...rendering.planes import skip_where_missing

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot fork")

LIMIT = 30.0


def run_and_note(work, **options):
    """The id of the process that does `work`, noted before it begins, with what came back or was raised."""
    heard = []

    def noting(tell):
        tell(os.getpid(), 0)
        return work(tell)

    try:
        options = {"silence_limit": LIMIT, "progress": lambda process, _: heard.append(process), **options}
        result = run_isolated(noting, **options)
    except BaseException as error:
        result = error
    return heard[0], result


def is_gone(process):
    """Whether a process ends within a few seconds."""
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_the_answer_comes_back_from_another_process():
    process, answer = run_and_note(lambda tell: np.arange(3).tolist())
    assert answer == [0, 1, 2]
    assert process != os.getpid()
    assert is_gone(process)


def test_signs_of_life_are_passed_on():
    def work(tell):
        for step in range(4):
            tell(step, 4)
        return "done"

    heard = []
    assert run_isolated(work, silence_limit=LIMIT, progress=lambda done, total: heard.append((done, total))) == "done"
    assert heard == [(0, 4), (1, 4), (2, 4), (3, 4)]


def test_what_is_logged_there_is_logged_here_and_the_same_words_once(caplog, capfd):
    def work(tell):
        logging.getLogger("filters.of.mine").warning("%s makes no use of %s", "Mine", "wheels")
        logging.getLogger("filters.of.mine").warning("%d arguments", "too few")
        logging.getLogger("filters.of.mine").info("a detail")

    for _ in range(3):
        run_isolated(work, silence_limit=LIMIT)
    assert caplog.record_tuples == [("filters.of.mine", logging.WARNING, "Mine makes no use of wheels")]
    assert "Mine" not in capfd.readouterr().err


class TwoWords(Exception):
    """Can be pickled, but not unpickled: pickle calls it with one argument."""

    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory of a process")
def test_work_that_takes_more_memory_than_there_is_gets_an_error_and_nobody_else_does():
    half = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2  # each of which the system gives
    with pytest.raises(MemoryError):
        run_isolated(lambda tell: len([np.empty(half, dtype=np.uint8) for _ in range(4)]), silence_limit=LIMIT)
    assert run_isolated(lambda tell: np.zeros(2**28, dtype=np.uint8).size, silence_limit=LIMIT) == 2**28


def test_work_that_writes_without_end_gets_an_error(tmp_path):
    def work(tell):
        with open(tmp_path / "endless", "wb") as file:
            os.posix_fallocate(file.fileno(), 0, process_server.LARGEST_FILE + 1)

    with pytest.raises(OSError, match="too large"):
        run_isolated(work, silence_limit=LIMIT)
    assert (tmp_path / "endless").stat().st_size == 0


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (lambda: ValueError("sigma must be > 0"), ValueError, "^sigma must be > 0$"),
        (lambda: TwoWords("bad", "luck"), RuntimeError, "TwoWords: bad luck"),
    ],
)
def test_an_error_is_raised_here(error, kind, words):
    def work(tell):
        raise error()

    with pytest.raises(kind, match=words):
        run_isolated(work, silence_limit=LIMIT)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda: os._exit(3), "ended with code 3"),
        (lambda: os.kill(os.getpid(), signal.SIGUSR1), "ended by SIGUSR1"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "ended by SIGSEGV"),
        (lambda: os.kill(os.getpid(), signal.SIGRTMIN + 3), f"ended by signal {signal.SIGRTMIN + 3}$"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), r"ended by SIGKILL \(has memory run out\?\), twice"),
    ],
)
def test_a_crash_is_told(end, words):
    with pytest.raises(WorkDied, match=words):
        run_isolated(lambda tell: end(), silence_limit=LIMIT)


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_what_is_ended_from_outside_is_done_once_more(by, tmp_path, caplog):
    def work(tell):
        (tmp_path / str(os.getpid())).touch()
        if len(list(tmp_path.iterdir())) == 1:
            os.kill(os.getpid(), by)
        return "done"

    assert run_isolated(work, silence_limit=LIMIT) == "done"
    assert f"its process was ended by {by.name}" in caplog.text
    assert "done once more" in caplog.text


def child_that_sleeps():
    return subprocess.Popen(["sleep", "60"]).pid


@pytest.mark.parametrize("end", ["returns", "crashes", "hangs"])
def test_what_the_work_has_started_ends_with_it(end):
    def work(tell):
        tell(child_that_sleeps(), 0)
        if end == "crashes":
            os._exit(3)
        if end == "hangs":
            time.sleep(60)

    heard = []
    with suppress(WorkDied, WorkTooSlow):
        limit = 8.0 if end == "hangs" else LIMIT  # a process on a busy machine needs seconds to begin
        run_isolated(work, silence_limit=limit, progress=lambda process, _: heard.append(process))
    assert len(heard) == 1
    assert is_gone(heard[0])


def test_a_process_that_leaves_a_child_with_its_connection_is_told_at_once():
    """The child is in a session of its own, so that it does not end with the process."""

    def work(tell):
        if os.fork() == 0:
            os.setsid()
            tell(0, 1)
            time.sleep(40)
            os._exit(0)
        time.sleep(1.0)
        os._exit(3)

    began = time.monotonic()
    with pytest.raises(WorkDied, match="ended with code 3"):
        run_isolated(work, silence_limit=30.0)
    assert time.monotonic() - began < 15


def test_half_an_answer_is_not_waited_for():
    def work(tell):
        send = tell.__closure__[0].cell_contents
        os.write(send.__closure__[0].cell_contents.fileno(), b"\x00\x00\x10\x00half")
        time.sleep(60)

    with pytest.raises(WorkTooSlow, match="half a sign of life"):
        run_isolated(work, silence_limit=1.0)


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGSTOP])
def test_nobody_suffers_from_what_another_does_to_the_server(by):
    """One ends or stops the server while an innocent one works."""
    answers = {}

    def innocent(tell):
        for _ in range(20):
            time.sleep(0.1)
            tell(0, 1)
        return "innocent"

    def guilty(tell):
        os.kill(os.getppid(), by)
        return "guilty"

    def ask(work, first):
        time.sleep(0.0 if first else 0.7)
        try:
            answers[work.__name__] = run_isolated(work, silence_limit=20.0)
        except Exception as error:
            answers[work.__name__] = error

    run_isolated(lambda tell: None, silence_limit=LIMIT)  # the server is there
    began = time.monotonic()
    threads = [threading.Thread(target=ask, args=given) for given in ((innocent, True), (guilty, False))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT * 2)
    assert answers["innocent"] == "innocent"
    assert run_isolated(lambda tell: "later", silence_limit=LIMIT) == "later"
    assert time.monotonic() - began < LIMIT  # a server that was stopped is told to go on
    if by == signal.SIGKILL and isinstance(answers["guilty"], Exception):
        assert "the server of processes has ended, twice" in str(answers["guilty"])


def test_threads_that_wait_end_with_their_block():
    heard = queue.Queue()

    def work():
        return run_isolated(
            lambda tell: tell(os.getpid(), 0) or time.sleep(60), silence_limit=60, progress=lambda p, _: heard.put(p)
        )

    with isolation.waiting_threads(2) as submit:
        futures = [submit(work), submit(work)]
        processes = [heard.get(timeout=LIMIT), heard.get(timeout=LIMIT)]
        began = time.monotonic()
    assert time.monotonic() - began < 20
    assert all(isinstance(future.exception(), CancelledError) for future in futures)
    assert all(map(is_gone, processes))


class Wordless(Exception):
    def __str__(self):
        raise RuntimeError("no words")


def test_an_error_without_words_is_an_error():
    class Unsendable(Wordless):
        def __reduce__(self):
            raise TypeError("no way")

    def work(tell):
        raise Unsendable

    with pytest.raises(RuntimeError, match=r"the answer cannot be sent: Unsendable: its message cannot be read"):
        run_isolated(work, silence_limit=LIMIT)


def test_silence_is_ended_but_not_slowness():
    def slow(tell):
        for step in range(6):
            time.sleep(0.2)
            tell(step, 6)
        return "late"

    assert run_isolated(slow, silence_limit=1.0) == "late"
    began = time.monotonic()
    process, error = run_and_note(lambda tell: time.sleep(60), silence_limit=0.5)
    assert isinstance(error, WorkTooSlow)
    assert "no sign of life" in str(error)
    assert time.monotonic() - began < 10
    assert is_gone(process)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_what_is_compiled_is_a_sign_of_life_and_only_then():
    def compiling(tell, pause):
        for number in range(2):
            time.sleep(pause)
            numba.njit(lambda x, more=number: x + more)(1.0)
        time.sleep(pause)
        return "compiled"

    heard = []
    told = {"silence_limit": 8.0, "progress": lambda *told: heard.append(told)}
    assert run_isolated(lambda tell: compiling(tell, 3.5), **told) == "compiled"
    assert heard == []  # no progress of the work is made up
    with pytest.raises(WorkTooSlow, match="no sign of life"):
        run_isolated(lambda tell: compiling(tell, 0.0) and time.sleep(60), silence_limit=2.0)


def test_an_endless_loop_that_logs_is_ended():
    def work(tell):
        for step in range(1000):
            logging.getLogger("filters.of.mine").warning("still at it, %d", step)
            time.sleep(0.05)

    began = time.monotonic()
    with pytest.raises(WorkTooSlow):
        run_isolated(work, silence_limit=0.5)
    assert time.monotonic() - began < 10


def test_what_cannot_be_sent_is_an_error():
    lock = threading.Lock()
    with pytest.raises(RuntimeError, match=r"the answer cannot be sent: TypeError: .*lock"):
        run_isolated(lambda tell: threading.Lock(), silence_limit=LIMIT)
    with pytest.raises(ValueError, match=r"work must be picklable.*lock"):
        run_isolated(lambda tell: lock, silence_limit=LIMIT)


def test_an_interruption_here_ends_the_work_there():
    def interrupt(process, _):
        heard.append(process)
        raise KeyboardInterrupt

    def work(tell):
        tell(os.getpid(), 0)
        time.sleep(60)

    heard = []
    with pytest.raises(KeyboardInterrupt):
        run_isolated(work, silence_limit=LIMIT, progress=interrupt)
    assert is_gone(heard[0])


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="threads are counted in /proc")
def test_the_process_has_one_thread_whatever_this_one_has():
    stop = threading.Event()
    threads = [threading.Thread(target=stop.wait, args=(LIMIT,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        count = run_isolated(lambda tell: len(os.listdir("/proc/self/task")), silence_limit=LIMIT)
    finally:
        stop.set()
        for thread in threads:
            thread.join(LIMIT)
    assert count == 1


def test_a_process_has_the_machine_code_of_usual_trials_before_it_begins():
    """Loading it would cost it some 0.1 s, more than many trials."""

    def loaded(tell):
        from filters.kernels import prediction
        from stereo_slam_env.simulator.frame_kernel import run_frame
        from stereo_slam_env.world.street_plan import plan

        return [len(kernel.signatures) for kernel in (run_frame, plan)], "_compiled" in vars(prediction.predict)

    assert run_isolated(loaded, silence_limit=LIMIT) == ([1, 1], True)


def test_several_threads_may_ask_at_once():
    answers = {}

    def ask(number):
        answers[number] = run_isolated(lambda tell: (number, os.getpid()), silence_limit=LIMIT)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT)
    assert {number: answer[0] for number, answer in answers.items()} == {number: number for number in range(4)}
    assert len({process for _, process in answers.values()}) == 4


def test_a_server_that_was_killed_is_started_again(caplog):
    server = run_isolated(lambda tell: os.getppid(), silence_limit=LIMIT)
    os.kill(server, signal.SIGKILL)
    os.waitid(os.P_PID, server, os.WEXITED | os.WNOWAIT)
    assert run_isolated(lambda tell: os.getppid(), silence_limit=LIMIT) != server
    assert "started again" in caplog.text


def test_a_server_that_does_not_start_is_told_within_its_limit(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/sleep")
    with pytest.raises(NoProcess, match="the server of processes ended with code"):
        isolation._Server()


def test_a_server_whose_caller_was_killed_before_it_was_ready_ends_in_silence():
    ours, its = socket.socketpair()
    ours.close()
    code = f"from stereo_slam_env.benchmark.running.process_server import serve; serve({its.fileno()})"
    with its:
        ended = subprocess.run(
            [sys.executable, "-c", code], pass_fds=[its.fileno()], capture_output=True, text=True, timeout=120
        )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


KILLED = """
import os, signal, subprocess, time
from stereo_slam_env.benchmark.running.isolation import run_isolated

class Mine:  # of a script without a guard
    def __call__(self, tell):
        tell(os.getpid(), os.getppid())
        for detached in (False, True):
            tell(subprocess.Popen(["sleep", "60"], start_new_session=detached).pid, 0)
        tell(0, 0)
        time.sleep(60)

def told(process, server):
    if process == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    print(process, *([server] if server else []), flush=True)

run_isolated(Mine(), silence_limit=60, progress=told)
"""


def test_everything_ends_with_its_caller(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    ended = subprocess.run(
        [sys.executable, script], stdout=subprocess.PIPE, timeout=60, check=False, env={**os.environ, "PYTHONPATH": "."}
    )
    assert ended.returncode == -signal.SIGKILL
    processes = [int(word) for word in ended.stdout.split()]
    assert len(processes) == 4  # the class of the script was found, and the script was not run again
    assert all(is_gone(process) for process in processes)


BUSY_PARENT = """
import os, sys, threading

import numpy as np
import gymnasium as gym
import stereo_slam_env
from stereo_slam_env.benchmark import Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import StreetSource
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice

options = {"route": "right-turn", "rig": "qvga", "max_landmarks": 40, "sensor": "images", "renderer": "gl"}
env = gym.make("StereoSlam/Drive-v0", policy="route", **options)
env.reset(seed=0)  # draws: the driver has threads
env.step(env.action_space.sample())
np.linalg.inv(np.eye(800) + 0.1)  # BLAS has threads
try:
    from dask.distributed import Client
    client = Client(processes=False, n_workers=2, dashboard_address=":0")
except ImportError:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
assert threading.active_count() > 1
scenario = Scenario("busy", StreetSource(options), filters=(filter_choice("inverse-depth"),), seeds=(0, 1), frames=3)
for jobs in (1, 2):
    result = run_benchmark(scenario, os.path.join(sys.argv[1], str(jobs)), jobs=jobs)
    assert [r.failure for r in result.runs] == [None, None], result.runs
print("done")
"""


@pytest.mark.slow
def test_a_process_that_has_drawn_and_has_threads_can_bench(tmp_path):
    skip_where_missing("gl")
    (tmp_path / "busy.py").write_text(BUSY_PARENT)
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-W", "error:This process:DeprecationWarning", tmp_path / "busy.py", tmp_path],
        env={**environment, "PYTHONPATH": ".", "OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("done\n")
