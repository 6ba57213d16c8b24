"""Which choice makes the difference, from made-up experiments with known answers (4 s)."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.scenarios.study import factorial_label
from stereo_slam_env.benchmark.statistics.attribution import attribute, attribute_runs
from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.effects import Response

from ....synthetic_runs import Behaviour, make_runs, scored

FACTORS = {
    "landmark": ("inverse-depth", "euclidean", "hybrid"),
    "measurement": ("joint", "left"),
    "error": ("quaternion", "so3"),
}
LEFT = np.log(2.1)
EUCLIDEAN = np.log(1.3)


def logarithms(seeds=10, scatter=0.1, seed=0, together=0.0):
    """'left' instead of 'joint' makes it 2.1 times as large, 'euclidean' 1.3 times; seeds differ far more."""
    rng = np.random.default_rng(seed)
    effects = np.zeros((3, 2, 2, 1))
    effects[1] += EUCLIDEAN
    effects[:, 1] += LEFT
    effects[1, 1] += together
    return effects + rng.standard_normal(seeds) + scatter * rng.standard_normal((3, 2, 2, seeds))


def attributed(data, **options):
    return attribute(FACTORS, {"position error": Response(data, "m")}, **options)


def contrast(attribution, level):
    return next(c for c in attribution.responses[0].contrasts if c.level == level)


def test_the_choices_that_matter_are_found_with_their_factors():
    attribution = attributed(logarithms())
    left, euclidean, so3 = (contrast(attribution, level) for level in ("left", "euclidean", "so3"))
    assert left.difference.percent == pytest.approx(110.0, abs=10.0)
    assert left.difference.interval_percent[0] < 110.0 < left.difference.interval_percent[1]
    assert (left.instead_of, euclidean.instead_of, so3.instead_of) == ("joint", "inverse-depth", "quaternion")
    assert (left.finding, euclidean.finding) == (Finding.WORSE, Finding.WORSE)
    assert so3.finding is Finding.NOT_SHOWN
    assert re.search(r"'left' instead of 'joint' makes it 1\d\d % larger \(", attribution.conclusion)
    assert attribution.conclusion.startswith("Position error – measurement: ")
    assert attribution.conclusion.endswith("error: not significant.")
    shares = attribution.responses[0].shares
    assert list(shares)[:2] == [("measurement",), ("landmark",)]
    assert list(shares)[-1] == ()
    assert sum(shares.values()) == pytest.approx(100.0)


def test_an_interaction_is_found_and_named():
    attribution = attributed(logarithms(together=0.6))
    assert "landmark and measurement do not act independently" in attribution.conclusion
    effect = next(e for e in attribution.responses[0].interactions if e.levels == ("euclidean", "left"))
    assert effect.difference.shown
    assert effect.difference.percent == pytest.approx(100 * np.expm1(0.6 / 3), abs=6.0)
    assert "independently" not in attributed(logarithms()).conclusion


def test_intervals_of_all_contrasts_hold_together():
    held = 0
    for seed in range(25):
        attribution = attributed(logarithms(seeds=8, scatter=0.3, seed=seed))
        truths = {"euclidean": 30.0, "hybrid": 0.0, "left": 110.0, "so3": 0.0}
        held += all(
            c.difference.interval_percent[0] <= truths[c.level] <= c.difference.interval_percent[1]
            for c in attribution.responses[0].contrasts
        )
    assert held / 25 >= 0.93


def test_a_choice_without_effect_is_hardly_ever_said_to_have_one():
    alarms = [
        contrast(attributed(logarithms(scatter=0.3, seed=seed)), "so3").finding is not Finding.NOT_SHOWN
        for seed in range(100, 125)
    ]
    assert np.mean(alarms) <= 0.05


def test_too_few_seeds_are_called_so():
    attribution = attributed(logarithms(seeds=4))
    assert contrast(attribution, "left").difference.interval_percent is None
    assert "4 seeds are too few, 8 are needed" in attribution.conclusion


def test_of_consistency_nearer_to_the_ideal_is_better():
    cautious = logarithms() - logarithms().mean() - 2.0
    attribution = attribute(FACTORS, {"pose NEES / 6": Response(cautious, ideal=1.0)})
    assert contrast(attribution, "left").difference.percent > 0
    assert contrast(attribution, "left").finding is Finding.BETTER


def test_runs_that_diverged_are_left_out_and_counted():
    data, diverged = logarithms(), np.zeros((3, 2, 2, 10), dtype=bool)
    diverged[1, 1, 0, :7] = True
    diverged[2, 0, 0, 0] = True
    spoilt = np.where(diverged, data + 8.0, data)
    attribution = attributed(spoilt, diverged=diverged)
    assert contrast(attribution, "left").difference.percent == pytest.approx(110.0, abs=15.0)
    assert attribution.combinations == 11
    said = "Left out, because more than half of the runs diverged: euclidean+left+quaternion (7 of 10)."
    assert said in attribution.notes
    assert "Runs that diverged are left out, which flatters hybrid+joint+quaternion (1 of 10)." in attribution.notes
    assert attribution.diverged_percent["landmark", "euclidean"] == pytest.approx(17.5)


def test_a_level_that_always_diverges_is_left_out():
    diverged = np.zeros((3, 2, 2, 10), dtype=bool)
    diverged[1] = True
    attribution = attributed(logarithms(), diverged=diverged)
    assert attribution.factors["landmark"] == ("inverse-depth", "hybrid")
    assert "Nothing can be said about landmark = euclidean." in attribution.notes
    diverged[2] = True
    attribution = attributed(logarithms(), diverged=diverged)
    assert list(attribution.factors) == ["measurement", "error"]
    assert "Nothing can be said about landmark: fewer than two of its levels are left." in attribution.notes
    assert contrast(attribution, "left").finding is Finding.WORSE


def test_an_empty_cell_costs_the_interaction_only():
    ran = np.ones((3, 2, 2, 10), dtype=bool)
    ran[1, 1] = False
    attribution = attributed(logarithms(), ran=ran)
    assert "The interaction of landmark and measurement cannot be estimated from what is left." in attribution.notes
    assert any("There are no runs of euclidean+left+quaternion, euclidean+left+so3" in n for n in attribution.notes)
    assert contrast(attribution, "left").difference.percent == pytest.approx(110.0, abs=15.0)


def test_impossible_input_is_refused():
    with pytest.raises(ValueError, match="factor 'error' must have at least two different levels"):
        attribute({"error": ("so3",)}, {})
    with pytest.raises(ValueError, match=r"response 'x' must be of shape .* levels \(3, 2, 2\), got \(2, 5\)"):
        attribute(FACTORS, {"x": Response(np.zeros((2, 5)))})
    with pytest.raises(ValueError, match="no factor has two levels left"):
        attributed(logarithms(), diverged=np.ones((3, 2, 2, 10), dtype=bool))


def test_runs_are_found_by_the_names_of_their_options():
    """A NEES/6 of 0.8 is nearer to 1 than one of 3, though not in difference from 2."""
    factorial = {"measurement": ("joint", "left"), "error": ("quaternion", "so3")}
    sure = {"joint": 3.0, "left": 0.8}
    behaviours = [
        Behaviour(factorial_label({"measurement": m, "error": e}), 0.1, overconfidence=np.sqrt(sure[m]))
        for m in factorial["measurement"]
        for e in factorial["error"]
    ]
    runs = make_runs([*behaviours, Behaviour("another", 0.1)], seeds=range(8), frames=400)
    runs[0] = replace(runs[0], failure="frame 1: gone")
    attribution = attribute_runs(factorial, scored(runs)[1])
    assert [r.response for r in attribution.responses] == ["position error", "pose NEES / 6", "time"]
    nees = attribution.responses[1].contrasts[0]
    assert (nees.level, nees.finding) == ("left", Finding.BETTER)
    assert attribution.seeds == 8
    assert "joint+quaternion (1 of 8)" in attribution.notes[0]
    with pytest.raises(ValueError, match=r"named after their options, like 'joint\+quaternion': there are none"):
        attribute_runs(factorial, scored(runs[4::5])[1])
