"""Processor time of fresh interpreters: imports, and the first frames of filters with no machine code on the disk.

    python benchmarks/start_up.py                      # two minutes
    python benchmarks/start_up.py --filters inverse-depth msckf

Of an import the least of `--repeats` interpreters counts, which have run it once before. The first frames (three of 25
landmarks, of each filter after the other in one interpreter) are what a user waits for once: the code is compiled into
an empty folder, and loaded from there by the second interpreter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from harness import arguments, show

ROOT = Path(__file__).resolve().parents[1]
MODULES = {
    "an empty program": "pass",
    "NumPy alone": "import numpy",
    "import filters": "import filters",
    "from filters import StereoCamera, StereoNoise": "from filters import StereoCamera, StereoNoise",
    "from filters import make_filter": "from filters import make_filter; make_filter",
    "import stereo_slam_env": "import stereo_slam_env",
    "stereo-slam --help": "from stereo_slam_env.__main__ import main; main()",
}
FRAMES = """
import sys, time
import numpy as np
from filters import StereoObservation, make_filter
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE

rng = np.random.default_rng(0)
uvd = rng.uniform((400.0, 100.0, 5.0), (900.0, 300.0, 40.0), (25, 3))
for name in sys.argv[1:]:
    began = time.process_time()
    slam = make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE)
    for frame in range(3):
        if frame:
            slam.predict(0.1)
        slam.update(StereoObservation(np.arange(25), uvd + rng.standard_normal((25, 3))))
    print(name, time.process_time() - began)
"""


def interpreter(code: str, *given: str, **variables: str) -> tuple[float, str]:
    """Processor time of a fresh interpreter, s, and what it printed."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    began = os.times()
    environment = {**os.environ, "PYTHONPATH": path, **variables}
    run = subprocess.run([sys.executable, "-c", code, *given], env=environment, capture_output=True, check=True)
    ended = os.times()
    spent = ended.children_user + ended.children_system - began.children_user - began.children_system
    return spent, run.stdout.decode()


def first_frames(filters: list[str], folder: str) -> dict[str, float]:
    """Seconds of the first frames of each filter, with the machine code of a folder."""
    lines = interpreter(FRAMES, *filters, NUMBA_CACHE_DIR=folder)[1].splitlines()
    return {name: float(seconds) for name, seconds in map(str.split, lines)}


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, repeats=4, filters=["inverse-depth", "shared-anchor", "right-invariant", "unscented"])
    rows = []
    for name, code in MODULES.items():
        options = [name.split()[1]] if name.startswith("stereo-slam") else []
        interpreter(code, *options)
        rows.append((name, f"{min(interpreter(code, *options)[0] for _ in range(given.repeats)):.2f}"))
    show("fresh interpreters", ("", "s"), rows)
    with tempfile.TemporaryDirectory() as folder:
        compiled, loaded = (first_frames(given.filters, folder) for _ in range(2))
    rows = [(name, f"{seconds:.1f}", f"{loaded[name]:.2f}") for name, seconds in compiled.items()]
    show("three first frames", ("filter", "s, compiled", "s, loaded from the disk"), rows)


if __name__ == "__main__":
    main()
