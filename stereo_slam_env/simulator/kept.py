"""`Kept`: what can be copied while it runs, and set back."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, ClassVar, NamedTuple

import numpy as np

State = dict[str, Any]


class Kept:
    """Something whose state is the attributes `changes`; all others are as its arguments made them."""

    changes: ClassVar[tuple[str, ...]] = ()

    def snapshot(self) -> State:
        """The state, a copy that can be pickled; what nobody changes, as scenes, is shared."""
        return {name: _copied(getattr(self, name)) for name in self.changes}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go back to a state, which stays as it is."""
        for name in self.changes:
            setattr(self, name, _restored(getattr(self, name), state[name]))


class _GeneratorState(NamedTuple):
    """A random generator, with what it needs to spawn the next ones."""

    kind: type[np.random.BitGenerator]
    seeds: dict[str, Any]
    state: Mapping[str, Any]


def _copied(value: Any) -> Any:
    if isinstance(value, Kept):
        return value.snapshot()
    if isinstance(value, np.random.Generator):
        bits = value.bit_generator
        return _GeneratorState(type(bits), bits.seed_seq.state, bits.state)  # type: ignore[attr-defined]
    return [_copied(each) for each in value] if _is_list_of_such(value) else deepcopy(value)


def _restored(now: Any, state: Any) -> Any:
    """What an attribute that is `now` becomes."""
    if isinstance(now, Kept):
        now.restore(state)
        return now
    if isinstance(state, _GeneratorState):
        bits = state.kind(np.random.SeedSequence(**state.seeds))
        bits.state = state.state
        return np.random.Generator(bits)
    if isinstance(state, list) and (_is_list_of_such(now) or _is_list_of_such(state)):
        pairs = zip(now if len(now) == len(state) else [None] * len(state), state, strict=True)
        return [_restored(*pair) for pair in pairs]
    return deepcopy(state)


def _is_list_of_such(value: Any) -> bool:
    """Whether something is a list with generators or `Kept` in it."""
    such = Kept, np.random.Generator, _GeneratorState
    return isinstance(value, list) and any(isinstance(each, such) or _is_list_of_such(each) for each in value)
