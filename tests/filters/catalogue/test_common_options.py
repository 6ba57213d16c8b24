"""Options that all filters of a comparison share: given to those that leave them open, and to no others."""

from __future__ import annotations

import inspect
from functools import partial
from typing import Any

import pytest

from filters import MotionModel, StereoEKF, StereoFilter, VelocityDriven, available_filters
from filters.catalogue.registry import NOT_OPEN, FilterFactory, MadeFilter, make_with_common_options
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.geometry.vectors import plus

from ..delayed import DelayedEKF

NUMBERS = {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.1}
COMMON = {"gate": 0.9, "motion": NUMBERS, "consensus": True}


class Gliding(MotionModel):
    """A motion model of somebody else's."""

    def step(self, x: Any, dt: float, n: Any) -> Any:
        velocity = plus(x.linear_velocity, n, 1.0)
        return plus(x.position, velocity, dt), x.orientation, velocity, x.angular_velocity

    def sigmas(self, dt: float) -> tuple[float, ...]:
        return 2.0 * dt, 2.0 * dt, 2.0 * dt


class Beside(StereoEKF):
    open_options = StereoEKF.open_options - {"motion"}

    def __init__(self, camera: Any, noise: Any, **options: Any) -> None:
        super().__init__(camera, noise, motion=Gliding(), **options)


class Unstated(StereoEKF):
    """Python refuses a motion model that is given twice: no statement is needed."""

    def __init__(self, camera: Any, noise: Any, **options: Any) -> None:
        super().__init__(camera, noise, motion=Gliding(), **options)


class Named(StereoEKF):
    """What a constructor names is its own without a word."""

    def __init__(self, camera: Any, noise: Any, *, motion: Any = Gliding(), **options: Any) -> None:  # noqa: B008
        super().__init__(camera, noise, motion=motion, **options)


class Merged(StereoEKF):
    open_options = StereoEKF.open_options - {"motion"}

    def __init__(self, camera: Any, noise: Any, **options: Any) -> None:
        super().__init__(camera, noise, **{"motion": Gliding(), **options})


class Inherited(Beside):
    pass


class InheritedWithOptions(Named):
    def __init__(self, camera: Any, noise: Any, *, limit: float = 1.0, **options: Any) -> None:
        super().__init__(camera, noise, **options)


class Wrapped(DelayedEKF):
    open_options = frozenset({"gate", "consensus"})

    def __init__(self, camera: Any, noise: Any, **options: Any) -> None:
        super().__init__(camera, noise, motion=Gliding(), **options)


def made(name: str | FilterFactory, common: dict[str, Any] = COMMON, **options: Any) -> MadeFilter:
    return make_with_common_options(name, REFERENCE_CAMERA, REFERENCE_NOISE, options, common)


def motion_of(stereo_filter: StereoFilter) -> Any:
    return (stereo_filter._past if isinstance(stereo_filter, DelayedEKF) else stereo_filter).options.motion


@pytest.mark.parametrize("factory", [Beside, Unstated, Named, Merged, Inherited, InheritedWithOptions, Wrapped])
def test_what_a_filter_does_not_leave_open_stands(factory: FilterFactory) -> None:
    result = made(factory)
    assert isinstance(motion_of(result.filter), Gliding)
    assert result.options == {"gate": 0.9, "consensus": True}
    assert result.not_given == {"motion": NOT_OPEN if factory is Wrapped else "it has its own, Gliding"}


@pytest.mark.parametrize("factory", [Named, Merged, InheritedWithOptions])
def test_what_is_meant_for_this_filter_goes_first(factory: FilterFactory) -> None:
    result = made(factory, motion="velocity-driven")
    assert motion_of(result.filter) == VelocityDriven()
    assert result.not_given == {}


def test_a_constructor_shows_what_its_class_leaves_open() -> None:
    class Few(StereoEKF):
        def __init__(self, camera: Any, noise: Any, *, gate: float | None = None, consensus: bool = True) -> None:
            super().__init__(camera, noise, gate=gate or 0.5, consensus=consensus)

    assert Few.open_options == {"gate"}
    assert Named.open_options == InheritedWithOptions.open_options == StereoEKF.open_options - {"motion"}
    assert StereoEKF.open_options == inspect.signature(StereoEKF).parameters.keys() - {"camera", "noise"}


def test_a_function_leaves_nothing_open_unless_it_says_so() -> None:
    def gliding(camera: Any, noise: Any, **options: Any) -> StereoFilter:
        return StereoEKF(camera, noise, motion=Gliding(), **options)

    assert made(gliding).options == made(partial(StereoEKF, motion=Gliding())).options == {}
    gliding.open_options = {"gate"}  # type: ignore[attr-defined]
    assert made(gliding).options == {"gate": 0.9}


def test_a_choice_that_equals_the_common_one_is_not_worth_a_remark() -> None:
    assert made(lambda camera, noise: StereoEKF(camera, noise, gate=0.9), {"gate": 0.9}).not_given == {}
    assert made(lambda camera, noise: StereoEKF(camera, noise), {"motion": "constant-velocity"}).not_given == {}


@pytest.mark.parametrize(
    "name", [name for name in available_filters() if name not in ("batch", "dead-reckoning", "inertial")]
)
def test_filters_with_the_papers_defaults_get_what_is_common(name: str) -> None:
    """As they were made before filters could keep a choice of their own."""
    common = {"gate": 0.9, "motion": NUMBERS}
    result = made(name, common)
    assert result.options == common
    assert not result.not_given


def test_who_does_not_know_an_option_goes_without_and_says_so() -> None:
    assert made("dead-reckoning").not_given == {"gate": NOT_OPEN, "consensus": NOT_OPEN}
    # Without a common gate nobody has one, and nothing need be said.
    assert made("dead-reckoning", {"gate": None}).not_given == {}


def test_another_type_error_is_not_hidden() -> None:
    def broken(camera: Any, noise: Any, **options: Any) -> StereoFilter:
        raise TypeError("motion has the wrong type: 'motion'")

    broken.open_options = {"motion"}  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="wrong type"):
        made(broken)


def test_a_refusal_is_an_error_and_no_sign_of_an_unknown_option() -> None:
    class Particular(StereoEKF):
        open_options = StereoEKF.open_options

        def __init__(self, camera: Any, noise: Any, *, gate: float = 0.99, **options: Any) -> None:
            if gate < 0.95:
                raise ValueError(f"gate must be >= 0.95 here, got {gate!r}: such a tight one loses the map")
            super().__init__(camera, noise, gate=gate, **options)

    assert made(Particular, {"gate": 0.97}).filter.options.gate == 0.97
    with pytest.raises(ValueError, match=r"gate must be >= 0\.95 here, got 0\.9"):
        made(Particular)
