"""Which options a reader has, by its signature."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def keyword_options(function: Callable[..., Any]) -> list[str]:
    """Names of the keyword-only parameters of a function."""
    parameters = inspect.signature(function).parameters
    return [name for name, parameter in parameters.items() if parameter.kind is inspect.Parameter.KEYWORD_ONLY]
