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
    RotationVectorError,
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
        ("motion", {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.1}, ConstantVelocity(1.0, 0.1)),
        ("error", {"name": "right-invariant", "reset": True}, RightInvariant(reset=True)),
        ("update", {"name": "unscented", "alpha": 0.1}, Unscented(alpha=0.1)),
    ],
)
def test_a_table_has_the_settings_of_the_part(slot: str, table: dict, part: object) -> None:
    before = dict(table)
    assert make_part(slot, table) == part
    assert table == before


@pytest.mark.parametrize(
    ("slot", "value", "message"),
    [
        *(("landmark", value, r"^landmark must be one of .* or a LandmarkModel, got")
          for value in (None, 3, ["euclidean"], {"name": 3}, Euclidean, RangeBearing())),
        *((slot, f"{name}x", f"{slot} must be one of '{name}'.*got '{name}x', did you mean '{name}'")
          for slot, name in ((slot, next(iter(SLOTS[slot].named))) for slot in SLOTS)),
        ("landmark", {"name": "hybrid", "linearity": 0.1}, "'hybrid' has no setting 'linearity', did you mean 'linear"),
        ("motion", {"sigma_acc": 1.0}, "'sigma_acc', did you mean 'sigma_acceleration'"),
        ("landmark", {"name": "hybrid", "linearity_limit": -1.0}, "linearity_limit must be"),
    ],
)  # fmt: skip
def test_what_is_no_part_is_refused_in_one_line(slot: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        make_part(slot, value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("slot", "name"), EVERY)
def test_a_filter_takes_every_part_by_its_name_a_table_or_as_an_object(slot: str, name: str) -> None:
    part = make_part(slot, name)
    assert isinstance(part, SLOTS[slot].kind)
    assert make_part(slot, part) is part
    slam = StereoEKF(**RIG, **{slot: name})
    assert type(part) is type(make_part(slot, {"name": name})) is type(getattr(slam.options, slot))


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


@pytest.mark.parametrize(
    ("entry_point", "module", "said", "refused"),
    [
        (
            "bad = part_plugin_bad:Error",
            "import no_such_module\n",
            "cannot be loaded: No module",
            "error must be one of",
        ),
        (
            "so3 = part_plugin_usurper:x",
            "x = 1\n",
            "'so3' of part_plugin_usurper:x is hidden by the built-in one",
            None,
        ),
        ("d = part_plugin_dict:make", "def make(): return {}\n", "", "error 'd' made a dict, not .*: derive it from"),
    ],
)
def test_a_broken_plugin_is_named_and_takes_nothing_down(
    install: Callable, caplog: pytest.LogCaptureFixture, entry_point: str, module: str, said: str, refused: str | None
) -> None:
    name, where = entry_point.split(" = ")
    install(where.partition(":")[0], "stereo_slam.errors", entry_point, module)
    with caplog.at_level(logging.WARNING):
        assert "so3" in available_parts("error")
    assert said in caplog.text
    assert type(make_part("error", "so3")) is RotationVectorError
    if refused:
        with pytest.raises(ValueError, match=refused):
            make_part("error", name)
