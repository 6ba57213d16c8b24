"""What can be set of the front end, and what cannot."""

from dataclasses import asdict

import pytest

from stereo_slam_env.frontend.settings import TrackerSettings


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("max_landmarks", 0), ("max_landmarks", 60.0), ("refill_below", -1), ("refill_below", 101), ("nearest", 0.0)),
        *(("min_disparity", -1.0), ("min_score", 1.5), ("uniqueness", 0.0), ("search_gate", None), ("gate", 1.0)),
        *(("max_radius", float("nan")), ("max_misses", -1), ("margin", 3), ("min_distance", 0.0)),
        *(("sigma_acceleration", 0.0), ("sigma_floor", -0.1), ("image_blur", -0.1), ("image_blur", float("nan"))),
        *(("disparity_offset", float("inf")), ("disparity_offset_sigma", -0.1)),
    ],
)
def test_an_impossible_value_is_named_in_one_line(field, value):
    with pytest.raises(ValueError, match=rf"\A.*{field}.*\Z"):
        TrackerSettings(**{field: value})


def test_what_is_not_set_is_as_documented():
    assert asdict(TrackerSettings()) == {
        **{"method": "active-search", "model": None, "matcher_model": None},
        **{"max_landmarks": 100, "refill_below": 85, "nearest": 2.5, "min_disparity": 1.0},
        **{"min_score": 0.8, "uniqueness": 0.92, "search_gate": 0.99, "max_radius": 24.0, "gate": 0.999},
        **{"max_misses": 2, "movers": False, "margin": 8, "min_distance": 10.0, "sigma_acceleration": 3.0},
        **{"sigma_angular_acceleration": 0.6, "disparity_offset": 0.0, "disparity_offset_sigma": 0.0},
        **{"sigma_floor": 0.05, "image_blur": 0.0, "sigma_relief": 0.04},
    }


def test_the_least_that_is_possible_is_taken():
    TrackerSettings(max_landmarks=1, refill_below=1, max_misses=0, margin=8, image_blur=0.0, disparity_offset=-3.0)
    TrackerSettings(max_landmarks=1, refill_below=0)
