"""The fault matrix from the command line, in a checkout: `python -m studies.faults`."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from stereo_slam_env.benchmark import Backend, filter_choice
from stereo_slam_env.files import own_files, write_text
from studies.faults import FAULTS, run_matrix


def main(arguments: Sequence[str] | None = None) -> int:
    """Run filters on faulty data; returns 1 if one broke its contract."""
    parser = argparse.ArgumentParser(prog="python -m studies.faults", description=main.__doc__)
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="default: all")
    parser.add_argument("--filters", default="inverse-depth,dual-bearing,euclidean", help="names, separated by commas")
    parser.add_argument("--seeds", type=int, default=3, help="drives of each fault and filter")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, help="directory for faults.json and faults.md")
    parser.add_argument("--list", action="store_true", help="print the faults and end")
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(f"{name:<18} {fault.line}" for name, fault in FAULTS.items()))
        return 0
    try:
        if options.out is not None:
            own_files(options.out, ("faults.json", "faults.md"))
        choices = [filter_choice(name.strip()) for name in options.filters.split(",")]
        faults = tuple(options.faults or FAULTS)
        matrix = run_matrix(choices, faults, options.seeds, Backend(jobs=options.jobs), show_progress)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    print(matrix.as_markdown())
    if options.out is not None:
        write_text(options.out / "faults.json", json.dumps(matrix.as_dict(), indent=1) + "\n")
        write_text(options.out / "faults.md", matrix.as_markdown())
        print(f"results: {options.out.resolve()}")
    return int(bool(matrix.broken))


def show_progress(done: int, total: int) -> None:
    """Drives that are finished, on one line of the terminal."""
    print(f"\r{done} of {total} drives", end="\n" if done == total else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
