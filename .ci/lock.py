"""Pins of `make test`: resolves all extras with each Python and writes `constraints.txt`. Needs pip and an index.

python .ci/lock.py python3.11 python3.12 python3.13

Nothing is installed. A package that the versions of Python take in different versions has a line for each.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "constraints.txt"
EXACTLY = "python_version == '{}'"
EXTRAS = re.search(r"^EXTRAS := (\S+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)[1]


def resolved(python):
    """Version of Python, and the versions of all packages that pip would install with it."""
    kept = FILE.with_name("constraints.by_hand.txt")
    kept.write_text("".join(line for line in FILE.read_text().splitlines(True) if "# by hand: " in line))
    try:
        command = [python, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet", "--report", "-"]
        done = subprocess.run(
            [*command, "--constraint", str(kept), f".[{EXTRAS}]"],
            cwd=ROOT,
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
    finally:
        kept.unlink()
    report = json.loads(done.stdout)
    found = {one["metadata"]["name"]: one["metadata"]["version"].partition("+")[0] for one in report["install"]}
    return report["environment"]["python_version"], {re.sub(r"[-_.]+", "-", k).lower(): v for k, v in found.items()}


def lines(found):
    """One line a package and version, with a marker where not all versions of Python take it."""
    for name in sorted({name for packages in found.values() for name in packages} - {"stereo-slam-env"}):
        by_version = {}
        for python, packages in found.items():
            if name in packages:
                by_version.setdefault(packages[name], []).append(python)
        for version, pythons in by_version.items():
            newest = list(found)[-len(pythons) :] == pythons
            marker = f"python_version >= '{pythons[0]}'" if newest else " or ".join(map(EXACTLY.format, pythons))
            yield f"{name}=={version}" + (f"; {marker}" if len(by_version) > 1 else "")


def main():
    """Write the file anew; the lines made by hand stay."""
    text = FILE.read_text(encoding="utf-8")
    by_hand = [line for line in text.splitlines() if "# by hand: " in line]
    named = {line.partition("==")[0] for line in by_hand}
    found = dict(map(resolved, sys.argv[1:]))
    pins = [line for line in lines(found) if line.partition("==")[0] not in named]
    head = [line for line in text.splitlines() if line.startswith("#")]
    FILE.write_text("\n".join([*head, *sorted([*by_hand, *pins])]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
