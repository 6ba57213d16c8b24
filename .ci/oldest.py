"""Requirements of `make test-oldest`: the oldest series of each declared dependency, one a line."""

import re
import sys
import tomllib
from pathlib import Path

text = (Path(__file__).resolve().parent.parent / "pyproject.toml").read_text(encoding="utf-8")
for requirement in tomllib.loads(text)["project"]["dependencies"]:
    declared, _, marker = requirement.partition(";")
    name, lowest = re.match(r"([\w-]+)>=([\d.]+)", declared).groups()
    sys.stdout.write(f"{name}=={lowest}.*" + (f" ;{marker}" if marker else "") + "\n")
