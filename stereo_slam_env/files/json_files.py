"""JSON that any reader takes: NaN and infinity are null."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from stereo_slam_env.files.folders import write_atomically


def json_text(data: Mapping[str, Any], *, indent: int | None = 2) -> str:
    """JSON of plain data, with a line break at the end; `indent` None: no other, and no spaces."""
    compact = msgspec.json.encode(data, enc_hook=_plain)
    return (compact if indent is None else msgspec.json.format(compact, indent=indent)).decode() + "\n"


def write_json(path: Path, data: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Write JSON, whole or not at all; `indent` as of `json_text`."""
    write_atomically(path, lambda stream: stream.write(json_text(data, indent=indent).encode()))


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else float(value)
