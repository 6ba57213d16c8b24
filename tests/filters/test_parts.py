"""The five slots: a part by its name, as a table of settings, or as an object; third parties' included."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import pytest

from filters import (
    ConstantVelocity,
    Euclidean,
    Hybrid,
    LeftThenRight,
    RangeBearing,
    RightInvariant,
    StereoEKF,
    StereoFilter,
    Unscented,
    available_parts,
    make_filter,
    make_part,
)
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.parts import SLOTS

RIG = {"camera": REFERENCE_CAMERA, "noise": REFERENCE_NOISE}
EVERY = [(slot, name) for slot in SLOTS for name in SLOTS[slot].named]


@pytest.mark.parametrize(("slot", "name"), EVERY)
def test_a_name_a_table_and_an_object_are_the_same_part(slot: str, name: str) -> None:
    part = make_part(slot, name)
    assert type(part) is type(make_part(slot, {"name": name}))
    assert isinstance(part, SLOTS[slot].kind)
    assert make_part(slot, part) is part


@pytest.mark.parametrize("slot", SLOTS)
def test_every_part_has_a_line_of_description(slot: str) -> None:
    lines = available_parts(slot)
    assert set(lines) >= set(SLOTS[slot].named)
    assert all(line.strip() and "\n" not in line and line != "no description" for line in lines.values())


@pytest.mark.parametrize(
    ("slot", "table", "part"),
    [
        ("landmark", {"name": "hybrid", "linearity_limit": 0.02}, Hybrid(linearity_limit=0.02)),
        ("measurement", {"name": "sequential", "copied_row_variance": 1.0}, LeftThenRight(1.0)),
        ("motion", {"name": "constant-velocity", "sigma_acceleration": 1.0}, ConstantVelocity(1.0)),
        ("error", {"name": "right-invariant", "reset": True}, RightInvariant(reset=True)),
        ("update", {"name": "unscented", "alpha": 0.1}, Unscented(alpha=0.1)),
    ],
)
def test_a_table_has_the_settings_of_the_part(slot: str, table: dict, part: object) -> None:
    before = dict(table)
    assert make_part(slot, table) == part
    assert table == before


def test_a_table_without_a_name_is_of_the_usual_part() -> None:
    numbers = {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.1}
    assert make_part("motion", numbers) == ConstantVelocity(1.0, 0.1)


@pytest.mark.parametrize("slot", SLOTS)
def test_an_unknown_name_lists_those_there_are(slot: str) -> None:
    name = next(iter(SLOTS[slot].named))
    with pytest.raises(
        ValueError, match=f"{slot} must be one of '{name}'.*got '{name}x', did you mean '{name}'"
    ) as error:
        make_part(slot, f"{name}x")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [None, 3, ["euclidean"], {"name": 3}, Euclidean])
def test_what_is_no_part_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"landmark must be one of .* or a LandmarkModel, got") as error:
        make_part("landmark", value)
    assert "\n" not in str(error.value)


def test_a_part_of_another_slot_is_refused() -> None:
    with pytest.raises(ValueError, match="landmark must be one of"):
        make_part("landmark", RangeBearing())


def test_an_unknown_setting_gets_a_hint() -> None:
    with pytest.raises(ValueError, match="'hybrid' has no setting 'linearity', did you mean 'linearity_limit'"):
        make_part("landmark", {"name": "hybrid", "linearity": 0.1})
    with pytest.raises(ValueError, match="'sigma_acc', did you mean 'sigma_acceleration'"):
        make_part("motion", {"sigma_acc": 1.0})


def test_an_impossible_setting_is_refused_by_the_part() -> None:
    with pytest.raises(ValueError, match="linearity_limit must be"):
        make_part("landmark", {"name": "hybrid", "linearity_limit": -1.0})


@pytest.mark.parametrize(("slot", "name"), EVERY)
def test_a_filter_takes_every_part_that_goes_with_the_others(slot: str, name: str) -> None:
    slam = StereoEKF(**RIG, **{slot: name})
    assert type(getattr(slam.options, slot)) is type(make_part(slot, name))


# --- third parties ---


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lays out a distribution with one entry point, as an installer would."""
    monkeypatch.syspath_prepend(tmp_path)

    def lay_out(name: str, group: str, entry_point: str, module: str) -> None:
        (tmp_path / f"{name}.py").write_text(module)
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\n{entry_point}\n")

    return lay_out


MINE = '''
from dataclasses import dataclass
from filters import Euclidean

@dataclass(frozen=True)
class Mine(Euclidean):
    """XYZ of mine."""
    strength: float = 1.0
'''


def test_a_third_party_part_is_one_like_the_others(install: Callable[..., None]) -> None:
    install("parts_plugin_mine", "stereo_slam.landmarks", "mine = parts_plugin_mine:Mine", MINE)
    assert available_parts("landmark")["mine"] == "XYZ of mine."
    assert make_part("landmark", {"name": "mine", "strength": 2.0}).strength == 2.0
    slam: StereoFilter = make_filter("inverse-depth", **RIG, landmark="mine")
    assert type(slam.options.landmark).__name__ == "Mine"
    with pytest.raises(ValueError, match="landmark 'mine' has no setting 'strenght', did you mean 'strength'"):
        make_part("landmark", {"name": "mine", "strenght": 2.0})


@pytest.mark.parametrize("slot", SLOTS)
def test_every_slot_has_a_group_of_its_own(slot: str, install: Callable[..., None]) -> None:
    name = next(iter(SLOTS[slot].named))
    kind = type(make_part(slot, name))
    module = f"from {kind.__module__} import {kind.__name__} as Kind\nclass Mine(Kind):\n    '''Mine.'''\n"
    install(f"parts_plugin_{slot}", f"stereo_slam.{slot}s", f"mine = parts_plugin_{slot}:Mine", module)
    assert type(make_part(slot, "mine")).__name__ == "Mine"


def test_a_broken_plugin_is_named_in_the_log_and_takes_nothing_down(
    install: Callable[..., None], caplog: pytest.LogCaptureFixture
) -> None:
    install("parts_plugin_bad", "stereo_slam.errors", "bad = parts_plugin_bad:Error", "import no_such_module\n")
    with caplog.at_level(logging.WARNING):
        assert "so3" in available_parts("error")
    assert "error 'bad' (parts_plugin_bad:Error) cannot be loaded: No module named 'no_such_module'" in caplog.text
    with pytest.raises(ValueError, match="error must be one of"):
        make_part("error", "bad")


def test_a_plugin_cannot_take_the_name_of_a_built_in(
    install: Callable[..., None], caplog: pytest.LogCaptureFixture
) -> None:
    install("parts_plugin_usurper", "stereo_slam.landmarks", "euclidean = parts_plugin_usurper:x", "x = 1\n")
    with caplog.at_level(logging.WARNING):
        assert "euclidean" in available_parts("landmark")
    assert make_part("landmark", "euclidean") == Euclidean()
    assert "'euclidean' of parts_plugin_usurper:x is hidden by the built-in one" in caplog.text


def test_a_plugin_that_makes_something_else_is_refused(install: Callable[..., None]) -> None:
    install("parts_plugin_dict", "stereo_slam.updates", "d = parts_plugin_dict:make", "def make(): return {}\n")
    with pytest.raises(ValueError, match="update 'd' made a dict, not a Linearisation: derive it from that"):
        make_part("update", "d")
