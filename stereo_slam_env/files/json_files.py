"""JSON that any reader takes: NaN and infinity are null."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from stereo_slam_env.files.folders import write_atomically


def json_text(data: Mapping[str, Any]) -> str:
    """JSON of plain data, indented, with a line break at the end."""
    return msgspec.json.format(msgspec.json.encode(data, enc_hook=_plain), indent=2).decode() + "\n"


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    write_atomically(path, lambda stream: stream.write(json_text(data).encode()))


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else float(value)
