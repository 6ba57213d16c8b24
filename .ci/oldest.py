"""Requirements of `make test-oldest`: the oldest series of each declared dependency, one a line."""

import re
import sys
from pathlib import Path

if sys.version_info < (3, 11):
    sys.exit("python 3.11 or newer reads pyproject.toml")
import tomllib

text = (Path(__file__).resolve().parent.parent / "pyproject.toml").read_text(encoding="utf-8")
for requirement in tomllib.loads(text)["project"]["dependencies"]:
    declared, _, marker = requirement.partition(";")
    name, lowest = re.match(r"([\w-]+)>=([\d.]+)", declared).groups()
    sys.stdout.write(f"{name}=={lowest}.*" + (f" ;{marker}" if marker else "") + "\n")
