"""Descriptions of the recordings of a run, which its filters were given."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.scenarios.streams import seed_description

Given = dict[int | None, dict[str, dict[str, Any]]]
"""Descriptions of the recordings, by seed, then label of the filter."""


def descriptions(out: Path, given: Given) -> list[dict[str, Any]]:
    """One description of each recording; a `ValueError` says that they were drawn by different renderers."""
    recordings = [{"seed": seed, **seed_description(of_seed)} for seed, of_seed in given.items()]
    # The same renderer of another version or device draws other pictures, too.
    drawn = {json.dumps(about.get("source", {}).get("renderer"), sort_keys=True) for about in recordings}
    if len(drawn) > 1:
        raise ValueError(
            f"{out}: its recordings were drawn by different renderers, {' and '.join(sorted(drawn))}, and are "
            f"not to be compared: choose another output directory"
        )
    return recordings
