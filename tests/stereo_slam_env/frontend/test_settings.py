"""What can be set of the front end, and what cannot."""

import pytest

from stereo_slam_env.frontend.settings import TrackerSettings


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_landmarks", 0),
        ("max_landmarks", 60.0),
        ("refill_below", -1),
        ("refill_below", 101),
        ("nearest", 0.0),
        ("min_disparity", -1.0),
        ("min_score", 1.5),
        ("uniqueness", 0.0),
        ("search_gate", None),
        ("gate", 1.0),
        ("max_radius", float("nan")),
        ("probation", True),
        ("max_misses", -1),
        ("margin", 3),
        ("min_distance", 0.0),
        ("sigma_acceleration", 0.0),
        ("sigma_floor", -0.1),
        ("image_blur", -0.1),
        ("image_blur", float("nan")),
        ("disparity_offset", float("inf")),
    ],
)
def test_an_impossible_value_is_named_in_one_line(field, value):
    with pytest.raises(ValueError, match=field) as error:
        TrackerSettings(**{field: value})
    assert "\n" not in str(error.value)


def test_settings_are_values():
    assert TrackerSettings() == TrackerSettings(max_landmarks=100)
    assert TrackerSettings() != TrackerSettings(max_landmarks=50, refill_below=50)
