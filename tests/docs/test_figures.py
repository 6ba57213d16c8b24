"""The figures of the concepts are drawn by their script, and all of them are there and shown (about 5 s)."""

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
specification = importlib.util.spec_from_file_location("concepts", DOCS / "images" / "concepts.py")
concepts = importlib.util.module_from_spec(specification)
specification.loader.exec_module(concepts)

QUICK = [draw for draw in concepts.FIGURES if draw.__name__ != "nees" and not draw.__name__.startswith("error_bounds")]
"""The others need a Monte Carlo run of half a minute."""


@pytest.mark.parametrize("draw", QUICK, ids=lambda draw: draw.__name__)
def test_the_script_draws_the_figure(draw):
    assert concepts.svg_of(draw()).count("<path") > 10


def test_every_figure_is_there_and_shown_and_no_other():
    wanted = {f"concept_{draw.__name__}.svg" for draw in concepts.FIGURES}
    pages = "".join((DOCS / page).read_text(encoding="utf-8") for page in ("concepts.md", "nees.md"))
    assert {path.name for path in (DOCS / "images").glob("concept_*.svg")} == wanted
    assert all(f"images/{name})" in pages for name in wanted)


def test_a_far_landmark_tells_the_orientation_and_a_new_one_nothing_of_the_pose():
    """What the page says of the figure."""
    gains = concepts.look_gains()
    near, _, far, new = gains["position"]
    assert gains["position"][near] > 10 * gains["position"][far]
    assert gains["orientation"][far] > 5 * gains["orientation"][near]
    assert abs(gains["orientation"][new]) < 0.01 > abs(gains["position"][new])
    assert gains["pose and map"][new] > 0
