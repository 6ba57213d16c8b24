"""Record of the constructor calls of a filter, from the outermost to the innermost class.

It shows which options a filter sets itself, however it is written: as a default, beside `**options`, in a dict.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec

P = ParamSpec("P")


@dataclass(frozen=True, eq=False)
class ConstructorCall:
    """One call of an `__init__`.

    Attributes
    ----------
    signature : inspect.Signature
        Of the constructor.
    arguments, options : tuple, mapping
        What it was called with, by position and by name.
    """

    signature: inspect.Signature
    arguments: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def given(self) -> Mapping[str, Any]:
        """Arguments of the call by the names of its parameters, without defaults."""
        return self.signature.bind_partial(*self.arguments, **self.options).arguments


_record: ContextVar[list[ConstructorCall] | None] = ContextVar("constructor_calls", default=None)


@contextmanager
def constructor_calls() -> Iterator[list[ConstructorCall]]:
    """The calls of recorded constructors in this thread, in their order."""
    calls: list[ConstructorCall] = []
    token = _record.set(calls)
    try:
        yield calls
    finally:
        _record.reset(token)


class RecordedConstructors:
    """Base of classes whose constructors, and those of all subclasses, `constructor_calls` sees."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "__init__" in vars(cls):
            cls.__init__ = _recorded(cls.__init__)  # type: ignore[method-assign]


def _recorded(constructor: Callable[P, None]) -> Callable[P, None]:
    @wraps(constructor)
    def recording(*args: P.args, **kwargs: P.kwargs) -> None:
        calls = _record.get()
        if calls is not None:
            calls.append(ConstructorCall(inspect.signature(constructor), args, kwargs))
        constructor(*args, **kwargs)

    return recording
