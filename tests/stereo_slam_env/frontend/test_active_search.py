"""A filter guides the search (about 3 s)."""

import dataclasses

import numpy as np
import pytest

from filters import make_filter
from filters.contract.noise import StereoNoise
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import ActiveSearch

from .drawn_street import CAMERA, DT, DrawnStreet

SETTINGS = TrackerSettings(max_landmarks=50, refill_below=40)


def guided(count, settings=SETTINGS, street=None):
    """Run a filter that starts at rest; its positions and observations, and what was seen on the way."""
    seen = []
    search = ActiveSearch(DrawnStreet(count) if street is None else street, settings, lambda _, pair: seen.append(pair))
    estimator = make_filter("inverse-depth", camera=CAMERA, noise=StereoNoise.diagonal(0.3, 0.3, 0.3))
    positions = []
    for number in range(count):
        if number:
            estimator.predict(DT)
        estimator.update(search.observe(number, estimator))
        positions.append(estimator.pose.position)
    return np.array(positions), seen


def test_a_filter_guides_the_search_for_twenty_pairs():
    street = DrawnStreet(20, step=(0.01, 0.0, 0.15))
    positions, seen = guided(20, street=street)
    assert min(len(pair.observation) for pair in seen) >= SETTINGS.refill_below - 10
    true = np.array([street.pose(number)[1] for number in range(20)])
    assert np.linalg.norm(positions - true, axis=1).max() < 0.05


def test_zero_starts_again_with_the_same_bits():
    search = ActiveSearch(DrawnStreet(3), SETTINGS)
    estimator = make_filter("inverse-depth", camera=CAMERA, noise=StereoNoise.diagonal(0.3, 0.3, 0.3))
    first = search.observe(0, estimator)
    again = search.observe(0, estimator)
    assert np.array_equal(first.ids, again.ids)
    assert np.array_equal(first.uvd, again.uvd)


def test_pairs_come_in_order_and_end():
    search = ActiveSearch(DrawnStreet(1), SETTINGS)
    estimator = make_filter("inverse-depth", camera=CAMERA, noise=StereoNoise.diagonal(0.3, 0.3, 0.3))
    with pytest.raises(ValueError, match="number must be 0 or 0, the next pair, got 2"):
        search.observe(2, estimator)
    search.observe(0, estimator)
    with pytest.raises(ValueError, match="no more pairs"):
        search.observe(1, estimator)


class Broken:
    """Forecasts NaN when it has been told to."""

    def __init__(self, estimator):
        self.estimator, self.broken = estimator, False

    def forecast(self):
        forecast = self.estimator.forecast()
        return dataclasses.replace(forecast, uvd=np.nan * forecast.uvd) if self.broken else forecast


def test_a_pair_that_a_bad_forecast_was_refused_for_can_be_asked_for_again():
    observed = []
    for refused in (False, True):
        search = ActiveSearch(DrawnStreet(2), SETTINGS)
        estimator = Broken(make_filter("inverse-depth", camera=CAMERA, noise=StereoNoise.diagonal(0.3, 0.3, 0.3)))
        estimator.estimator.update(search.observe(0, estimator))
        estimator.estimator.predict(DT)
        estimator.broken = refused
        if refused:
            with pytest.raises(ValueError, match=r"forecast\.uvd must be finite"):
                search.observe(1, estimator)
            estimator.broken = False
        observed.append(search.observe(1, estimator))
    assert len(observed[0]) > 10
    assert np.array_equal(observed[0].uvd, observed[1].uvd)
