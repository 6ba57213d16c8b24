"""Sentences of verdicts, remarks and changes: values are handed to the templates in `sentences.jinja`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from stereo_slam_env.benchmark.statistics.differences import (
    CONFIDENCE,
    MIN_PAIRS,
    TIE_PERCENT,
    Finding,
    listed,
    percent_words,
    signed,
)
from stereo_slam_env.benchmark.statistics.measures import pose_nees
from stereo_slam_env.evaluation.figures import readable

MOST_NAMED = 3
"""Of more filters, changes or scenarios than that, a sentence says only how many more there are."""


def sentence(template: str, /, *values: Any) -> str:
    """Text of a template of `sentences.jinja` in one line; empty where there is nothing to say."""
    text = str(getattr(_templates(), template)(*values)).strip()
    return re.sub(r" *\n\s*", " ", re.sub(r"\s*\n\s*(?=[,.;:)])", "", text))


def few(names: Sequence[str]) -> str:
    """The first of many names, and how many more there are: "a, b, c and 2 more"."""
    more = len(names) - MOST_NAMED
    return listed([*names[:MOST_NAMED], *([f"{more} more"] if more > 0 else [])])


@cache
def _templates() -> Any:
    from jinja2 import Environment, StrictUndefined  # `evaluate` does without

    environment = Environment(
        autoescape=False, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined, extensions=["jinja2.ext.do"]
    )
    environment.filters |= {
        "readable": readable,
        "listed": listed,
        "few": few,
        "percent": percent_words,
        "signed": signed,
        "quoted": repr,
        "begin": lambda words: re.sub("^(the|on|one|no) ", lambda match: match[0].capitalize(), words),
        "capital": lambda words: words[:1].upper() + words[1:],
    }
    environment.globals |= {
        "CONFIDENCE": CONFIDENCE,
        "MIN_PAIRS": MIN_PAIRS,
        "MOST_NAMED": MOST_NAMED,
        "TIE_PERCENT": TIE_PERCENT,
        "Finding": Finding,
        "pose_nees": pose_nees,
    }
    return environment.from_string(files(__package__).joinpath("sentences.jinja").read_text(encoding="utf-8")).module
