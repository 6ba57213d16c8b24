"""The process that atheris runs in: `python fuzz/guided.py SETTINGS`, started by `fuzz/run.py`.

It ends with the last input, whatever libFuzzer does then, so that what it found is written as it is found.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

with atheris.instrument_imports(include=["stereo_slam_env", "filters", "zipfile", "tomllib", "json"]):
    import cv2

    from fuzz.harness import Finding, Harness, limited_memory
    from fuzz.targets import targets

_TELL_EVERY = 500


class Session:
    """Counts inputs and keeps what they find."""

    def __init__(self, harness: Harness, out: Path) -> None:
        self.harness, self.out = harness, out
        self.inputs, self.began = 0, 0.0
        self.slowest = 0.0
        self.by_target: dict[str, int] = {}
        self.known: set[tuple[str, str]] = set()

    def one(self, data: bytes) -> None:
        """What atheris calls."""
        if self.inputs == 0:
            self.began = time.monotonic()
            limited_memory().__enter__()  # to the end of the process
        began = time.process_time()
        finding = self.harness.run(data)
        self.slowest = max(self.slowest, time.process_time() - began)
        self.inputs += 1
        if len(data) > 2:
            name = self.harness.targets[data[0] % len(self.harness.targets)].name
            self.by_target[name] = self.by_target.get(name, 0) + 1
        if finding is not None and finding.key not in self.known:
            self.known.add(finding.key)
            self._keep(finding)
        if self.inputs % _TELL_EVERY == 0:
            self.tell()

    def tell(self) -> None:
        """Write how far it is."""
        state = {
            "inputs": self.inputs,
            "seconds": time.monotonic() - self.began,
            "slowest_s": self.slowest,
            "by_target": self.by_target,
        }
        (self.out / "state.json").write_text(json.dumps(state))

    def _keep(self, finding: Finding) -> None:
        place = self.out / f"finding-{len(self.known):03d}"
        place.with_suffix(".input").write_bytes(finding.data)
        place.with_suffix(".txt").write_text(f"{finding.target} {finding.file}\n{finding.what}\n{finding.trace}\n")


def main(settings: Path) -> None:
    """Fuzz as the settings say."""
    told = json.loads(settings.read_text())
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(0)
    out = Path(told["out"])
    chosen = tuple(target for target in targets() if target.name in told["targets"])
    harness = Harness(chosen, Path(told["folder"]))
    corpus = out / "corpus"
    corpus.mkdir(exist_ok=True)
    for number in range(len(chosen)):
        for k, data in enumerate(harness.seeds(number)):
            (corpus / f"seed-{number}-{k}").write_bytes(data)
    session = Session(harness, out)
    # Pipes of the decoders' own warnings are closed; a hang that Python cannot see is libFuzzer's to end.
    options = [f"-runs={told['inputs']}", f"-max_total_time={told['seconds']}", f"-seed={told['seed']}"]
    options += [
        "-timeout=30",
        "-rss_limit_mb=0",
        "-max_len=20000",
        "-close_fd_mask=3",
        f"-artifact_prefix={out}/crash-",
    ]
    atheris.Setup([sys.argv[0], str(corpus), *options], session.one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
