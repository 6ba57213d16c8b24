"""Filters by name, third parties' included."""

from __future__ import annotations

from pathlib import Path

import pytest

from filters import DualBearingEKF, EuclideanEKF, InverseDepthStereoEKF, VelocityDriven, available_filters, make_filter
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE

RIG = {"camera": REFERENCE_CAMERA, "noise": REFERENCE_NOISE}


@pytest.mark.parametrize(
    ("name", "kind"),
    [("inverse-depth", InverseDepthStereoEKF), ("dual-bearing", DualBearingEKF), ("euclidean", EuclideanEKF)],
)
def test_the_three_filters_have_their_names(name: str, kind: type) -> None:
    assert isinstance(make_filter(name, **RIG), kind)
    assert len(available_filters()[name].splitlines()) == 1
    assert isinstance(make_filter(kind, **RIG, gate=0.9), kind)
    assert isinstance(make_filter(lambda camera, noise: kind(camera, noise), **RIG), kind)
    assert make_filter(name, **RIG, motion="velocity-driven").options.motion == VelocityDriven()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("inverse-dept", {}, "'inverse-dept', did you mean 'inverse-depth'"),
        ("inverse-depth", {"gate": 1.5}, "gate must be a probability"),
        ("euclidean", {"gat": 0.9}, "option 'gat' is not one of filter 'euclidean', did you mean 'gate'"),
        (EuclideanEKF, {"gat": 0.9}, "option 'gat' is not one of filter 'EuclideanEKF', did you mean 'gate'"),
        (dict, {}, "filter 'dict' made a dict, not a StereoFilter"),
        ("inverse-depth", {"motion": {"sigma_acc": 1.0}}, "'sigma_acc', did you mean 'sigma_acceleration'"),
        ("inverse-depth", {"landmark": "euclid"}, "landmark must be one of 'inverse-depth'.*did you mean 'euclidean'"),
    ],
)
def test_what_makes_no_filter_is_refused_with_a_hint(name: object, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_filter(name, **RIG, **options)


def _install(folder: Path, name: str, module: str, entry_points: dict[str, str]) -> None:
    """Lay out a distribution as an installer would."""
    (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{key} = {value}" for key, value in entry_points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[stereo_slam.filters]", *lines]))


@pytest.fixture
def plugin_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_a_third_party_filter_is_found(plugin_folder: Path) -> None:
    module = (
        '"""Plug-in."""\nfrom filters import EuclideanEKF\nclass Mine(EuclideanEKF):\n    """A filter of mine."""\n'
    )
    _install(plugin_folder, "slam_plugin_good", module, {"mine": "slam_plugin_good:Mine"})
    assert available_filters()["mine"] == "A filter of mine."
    assert type(make_filter("mine", **RIG)).__name__ == "Mine"
    with pytest.raises(ValueError, match="option 'gat' is not one of filter 'mine'"):
        make_filter("mine", **RIG, gat=0.9)


def test_a_plain_function_can_be_a_factory(plugin_folder: Path) -> None:
    module = (
        "from filters import InverseDepthStereoEKF\n"
        "def tight(camera, noise, *, gate=0.5):\n"
        '    """Inverse depth with a tight gate."""\n'
        "    return InverseDepthStereoEKF(camera, noise, gate=gate)\n"
    )
    _install(plugin_folder, "slam_plugin_function", module, {"tight": "slam_plugin_function:tight"})
    assert isinstance(make_filter("tight", **RIG, gate=0.7), InverseDepthStereoEKF)


def test_a_broken_plugin_is_named_and_takes_nothing_down(plugin_folder: Path) -> None:
    _install(plugin_folder, "slam_plugin_bad", "import no_such_module\n", {"bad": "slam_plugin_bad:Filter"})
    _install(plugin_folder, "slam_plugin_dict", "def make(camera, noise): return {}\n", {"d": "slam_plugin_dict:make"})
    _install(plugin_folder, "slam_plugin_usurper", "x = 1\n", {"euclidean": "slam_plugin_usurper:x"})
    listed = available_filters()
    assert "not available" in listed["bad"]
    assert "no_such_module" in listed["bad"]
    assert isinstance(make_filter("euclidean", **RIG), EuclideanEKF)
    for name, message in (("bad", "'bad'.*cannot be loaded: ModuleNotFoundError"), ("d", "'d' made a dict, not a")):
        with pytest.raises(ValueError, match=message):
            make_filter(name, **RIG)
