"""Time, memory and disk of the report of a large campaign, made from a small one.

    stereo-slam bench --scenario short.toml --out runs/short         # with more seeds than `kept_seeds`
    python benchmarks/campaign_report.py runs/short runs/large --seeds 10000
    python benchmarks/campaign_report.py runs/short runs/large --report

Trials of the small campaign that are not kept whole are repeated under new seeds until there are so many; `--report`
writes the report and prints what it took. Figures of such a campaign mean nothing, their number does.
"""

from __future__ import annotations

import io
import json
import resource
import shutil
import struct
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np

from harness import arguments
from stereo_slam_env.benchmark.storage.result_tables import write_results
from stereo_slam_env.benchmark.storage.run_files import seed_name
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.files.folders import write_json
from stereo_slam_env.files.readers import read_arrays, read_json
from stereo_slam_env.report.benchmark_report import write_report_of

MEGABYTE = 2.0**20


def multiply(small: Path, large: Path, count: int) -> None:
    """Make a campaign of `count` seeds in `large`."""
    (cell,) = read_study(small).cells
    whole, passing = (
        [seed for seed in cell.seeds if seed is not None and cell.keeps(seed) == kept] for kept in (True, False)
    )
    shutil.copytree(small, large, ignore=shutil.ignore_patterns("trials", "figures", "tables", "trajectories"))
    for name in ("settings.json", "study.json"):
        about = read_json(large / name)
        _set_seeds(about, list(range(count)))
        write_json(large / name, about)
    for choice in cell.scenario.competitors:
        sources = {seed: cell.trial_path(seed, choice).read_bytes() for seed in (*whole, *passing)}
        for seed in range(count):
            path = large / "trials" / seed_name(seed) / f"{choice.label}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            source = seed if seed in whole else passing[seed % len(passing)]
            path.write_bytes(sources[source] if source == seed else _with_seed(sources[source], seed))


def _set_seeds(about: object, seeds: list[int]) -> None:
    """Give every scenario in a description these seeds."""
    if isinstance(about, dict):
        for key, value in about.items():
            if key == "seeds":
                about[key] = seeds
            else:
                _set_seeds(value, seeds)
    elif isinstance(about, list):
        for value in about:
            _set_seeds(value, seeds)


def _with_seed(content: bytes, seed: int) -> bytes:
    """The archive of a trial under another seed; what is compressed is not touched."""
    archive = zipfile.ZipFile(io.BytesIO(content))
    about = json.loads(str(read_arrays(content, ["about"])["about"]))
    about["run"]["seed"] = about["figures"]["seed"] = seed
    text = io.BytesIO()
    np.save(text, np.array(json.dumps(about)))
    body, directory = b"", b""
    for info in archive.infolist():
        start = info.header_offset + 30 + sum(struct.unpack_from("<HH", content, info.header_offset + 26))
        packed, size, crc = content[start : start + info.compress_size], info.file_size, info.CRC
        if info.filename == "about.npy":
            squeeze = zlib.compressobj(6, zlib.DEFLATED, -15)
            packed, size, crc = (
                squeeze.compress(text.getvalue()) + squeeze.flush(),
                len(text.getvalue()),
                zlib.crc32(text.getvalue()),
            )
        name = info.filename.encode()
        common = struct.pack("<HHHHHLLLHH", 20, 0, 8, 0, 33, crc, len(packed), size, len(name), 0)
        directory += b"PK\1\2" + struct.pack("<H", 20) + common + struct.pack("<HHHLL", 0, 0, 0, 0, len(body)) + name
        body += b"PK\3\4" + common + name + packed
    entries = len(archive.infolist())
    return body + directory + b"PK\5\6" + struct.pack("<HHHHLLH", 0, 0, entries, entries, len(directory), len(body), 0)


def report(large: Path) -> None:
    """Write the report and print what it took."""
    began, busy = time.perf_counter(), time.process_time()
    study = read_study(large)
    results = write_results(study)
    read = time.process_time()
    page = write_report_of(study, results)
    took, worked = time.perf_counter() - began, time.process_time() - busy
    files = [path for path in large.rglob("*") if path.is_file()]
    disk = sum(path.stat().st_blocks * 512 for path in files)
    trials = sum(len(figures.of_run) for figures in results[0].figures.values())
    print(f"{trials} trials in {len(files)} files, {disk / MEGABYTE:.0f} MB, {disk / trials / 1024:.1f} kB a trial")
    print(f"report: {took:.1f} s, of the processor {worked:.1f} s (tables {read - busy:.1f} s)")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"memory {peak:.0f} MB, page {page.stat().st_size / MEGABYTE:.2f} MB")


def main() -> None:
    """Multiply a run, or report on one."""
    given = arguments(__doc__, "small", "large", small=Path, large=Path, seeds=10_000, report=False)
    if given.report:
        report(given.large)
    else:
        multiply(given.small, given.large, given.seeds)


if __name__ == "__main__":
    main()
