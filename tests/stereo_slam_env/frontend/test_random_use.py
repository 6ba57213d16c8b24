"""Any sequence of pairs, times and forecasts, legal or not, keeps the front end's promises (hypothesis; 10 s)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from filters.contract.outputs import Forecast
from filters.geometry.camera import StereoCamera
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker

from .drawn_street import CAMERA, DrawnStreet

SHAPE = (CAMERA.height, CAMERA.width)


@cache
def street(number):
    """Images of a drive."""
    pair = DrawnStreet(8).pair(number % 8)
    return pair.left, pair.right


def noise(rng):
    return rng.integers(0, 256, SHAPE, dtype=np.uint8)


def moved(images, columns=0, rows=0):
    return tuple(np.roll(image, (rows, columns), (0, 1)) for image in images)


def checks(rng):
    v, u = np.indices(SHAPE) // rng.integers(2, 30)
    return (255 * ((u + v) % 2)).astype(np.uint8)


PAIRS = {
    "drive": lambda rng, number: street(number),
    "cut": lambda rng, number: street(rng.integers(8)),
    "noise": lambda rng, number: (noise(rng), noise(rng)),
    "plane of noise": lambda rng, number: (image := noise(rng), np.roll(image, rng.integers(-60, 60), 1)),
    "constant": lambda rng, number: tuple(np.full(SHAPE, level, dtype=np.uint8) for level in rng.integers(256, size=2)),
    "black": lambda rng, number: (np.zeros(SHAPE, dtype=np.uint8),) * 2,
    "saturated": lambda rng, number: tuple(np.uint8(255) * (image > 100) for image in street(number)),
    "dim": lambda rng, number: tuple(image // 64 for image in street(number)),
    "left covered": lambda rng, number: (np.zeros(SHAPE, dtype=np.uint8), street(number)[1]),
    "right covered": lambda rng, number: (street(number)[0], np.zeros(SHAPE, dtype=np.uint8)),
    "swapped": lambda rng, number: street(number)[::-1],
    "shifted": lambda rng, number: moved(street(number), columns=rng.integers(-40, 40)),
    "out of rows": lambda rng, number: (street(number)[0], moved(street(number), rows=rng.integers(-5, 6))[1]),
    "upside down": lambda rng, number: tuple(image[::-1] for image in street(number)),
    "mirrored": lambda rng, number: tuple(image[:, ::-1] for image in street(number)),
    "checks": lambda rng, number: (image := checks(rng), np.roll(image, -7, 1)),
}

FORECASTS = {
    "none": lambda forecast, rng: None,
    "good": lambda forecast, rng: forecast,
    "wrong": lambda forecast, rng: replace(forecast, uvd=forecast.uvd + rng.normal(0, 100, forecast.uvd.shape)),
    "far out": lambda forecast, rng: replace(forecast, uvd=1e300 * forecast.uvd),
    "d <= 0": lambda forecast, rng: replace(forecast, uvd=forecast.uvd * [1, 1, -1]),
    "sure": lambda forecast, rng: replace(forecast, S=1e-12 * forecast.S),
    "certain": lambda forecast, rng: replace(forecast, S=0.0 * forecast.S),
    "unsure": lambda forecast, rng: replace(forecast, S=1e12 * forecast.S),
    "clueless": lambda forecast, rng: replace(forecast, S=1e300 * forecast.S),
    "out of view": lambda forecast, rng: replace(forecast, in_view=np.zeros(len(forecast.ids), dtype=bool)),
    "of others": lambda forecast, rng: replace(forecast, ids=forecast.ids + 100_000),
    "of nothing": lambda forecast, rng: part(forecast, slice(0)),
    "backwards": lambda forecast, rng: part(forecast, slice(None, None, -1)),
}

ILLEGAL = {
    "left of another size": lambda left, right, dt, forecast: (left[:-1], right, dt, forecast),
    "right of another size": lambda left, right, dt, forecast: (left, right.T, dt, forecast),
    "floats": lambda left, right, dt, forecast: (left.astype(float), right, dt, forecast),
    "colours": lambda left, right, dt, forecast: (left, np.stack([right] * 3, axis=2), dt, forecast),
    "a list": lambda left, right, dt, forecast: (left.tolist(), right, dt, forecast),
    "nothing": lambda left, right, dt, forecast: (left, None, dt, forecast),
    "no dt": lambda left, right, dt, forecast: (left, right, None, forecast),
    "dt of 0": lambda left, right, dt, forecast: (left, right, 0.0, forecast),
    "dt back": lambda left, right, dt, forecast: (left, right, -dt, forecast),
    "dt NaN": lambda left, right, dt, forecast: (left, right, np.nan, forecast),
    "dt infinite": lambda left, right, dt, forecast: (left, right, np.inf, forecast),
    "dt a word": lambda left, right, dt, forecast: (left, right, "soon", forecast),
    "forecast NaN": lambda left, right, dt, forecast: (left, right, dt, replace(forecast, uvd=np.nan * forecast.uvd)),
    "S infinite": lambda left, right, dt, forecast: (left, right, dt, replace(forecast, S=forecast.S + np.inf)),
    "S negative": lambda left, right, dt, forecast: (left, right, dt, replace(forecast, S=-forecast.S)),
    "S of one": lambda left, right, dt, forecast: (left, right, dt, replace(forecast, S=np.eye(3))),
    "ids twice": lambda left, right, dt, forecast: (left, right, dt, replace(forecast, ids=0 * forecast.ids)),
    "in_view numbers": lambda left, right, dt, told: (left, right, dt, replace(told, in_view=1.0 * told.in_view)),
    "a tuple": lambda left, right, dt, forecast: (left, right, dt, (forecast.ids, forecast.uvd)),
}

times = st.sampled_from([0.1, 0.1, 0.1, 0.1, 1e-300, 1e-9, 1e-3, 10.0, 1e6, 1e300])
calls = st.one_of(
    st.tuples(st.just("track"), st.just("drive"), times, st.sampled_from(["none", "good"])),
    st.tuples(st.just("track"), st.sampled_from(sorted(PAIRS)), times, st.sampled_from(sorted(FORECASTS))),
    st.tuples(st.just("refuse"), st.sampled_from(sorted(ILLEGAL))),
    st.tuples(st.just("reset")),
)
sequences = st.lists(calls, min_size=4, max_size=8)
options = st.fixed_dictionaries(
    {
        "max_landmarks": st.sampled_from([1, 5, 40]),
        "max_misses": st.integers(0, 3),
        "margin": st.sampled_from([8, 8, 100, 300]),
        "max_radius": st.sampled_from([0.01, 24.0, 1e9]),
        "nearest": st.sampled_from([1e-320, 2.5, 1e3]),
        "min_disparity": st.sampled_from([1e-3, 1.0, 1e3]),
        "min_distance": st.sampled_from([0.1, 10.0, 60.0]),
    }
)


def part(forecast, index):
    return Forecast(forecast.ids[index], forecast.uvd[index], forecast.S[index], forecast.in_view[index])


class Session:
    """A front end, and what a user of it knows."""

    def __init__(self, tracker_settings, seed=0):
        self.tracker = StereoTracker(CAMERA, tracker_settings)
        self.rng = np.random.default_rng(seed)
        self.reset()

    def reset(self):
        self.tracker.reset()
        self.number, self.newest, self.gone = 0, -1, set()
        self.last = None

    def forecast(self):
        """Of the landmarks the filter got last, about where they were; of some that there are not, if it has none."""
        ids, uvd = np.arange(2), np.array([[200.0, 100.0, 9.0], [300.0, 90.0, 4.0]])
        if self.last is not None and len(self.last.observation) > 1:
            ids = self.last.observation.ids
            uvd = self.last.observation.uvd + self.rng.normal(0, 3, (len(ids), 3))
        S = np.tile(self.rng.uniform(0.1, 30) * np.eye(3), (len(ids), 1, 1))
        return Forecast(ids, uvd, S, np.ones(len(ids), dtype=bool))

    def track(self, pair, dt, forecast):
        left, right = PAIRS[pair](self.rng, self.number)
        given = FORECASTS[forecast](self.forecast(), self.rng)
        before = left.copy(), right.copy()
        self.last = self.tracker.track(left, right, dt, given)
        assert np.array_equal(left, before[0])
        assert np.array_equal(right, before[1])
        self.number += 1
        self.look_at(self.last)

    def look_at(self, tracked):
        observation, corners, most = tracked.observation, tracked.corners, self.tracker.settings.max_landmarks
        assert len(observation) <= most
        for seen in (observation, corners):
            assert np.isfinite(seen.uvd).all()
            assert CAMERA.in_view(seen.uvd * [1, 1, 0]).all()
            assert np.isfinite(seen.R).all()
            assert len(seen) == 0 or np.linalg.eigvalsh(seen.R).min() > 0
        assert np.isfinite(tracked.search.predicted).all()
        assert np.isfinite(tracked.search.S).all()
        # Ids ascend, are new in one pair only, and do not come again.
        assert np.array_equal(corners.ids, self.newest + 1 + np.arange(len(corners)))
        self.newest += len(corners)
        assert not self.gone & set(observation.ids.tolist())
        self.gone |= set(tracked.dropped.tolist())
        step = self.tracker.last_step
        assert step is None or np.isfinite([*step[0].R.flat, *step[0].t]).all()

    def refuse(self, what):
        """A `ValueError` of one line; then everything is as if it had not been asked."""
        if self.number == 0:
            return  # the first pair needs neither time nor forecast
        before = dict(vars(self.tracker))
        with pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
            self.tracker.track(*ILLEGAL[what](*street(self.number), 0.1, self.forecast()))
        assert all(vars(self.tracker)[name] is value for name, value in before.items())


drawn = settings(
    deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None, print_blob=False
)


@settings(drawn, max_examples=40)
@given(chosen=options, sequence=sequences, seed=st.integers(0, 2**16))
def test_random_sequences_of_pairs(chosen, sequence, seed):
    session = Session(TrackerSettings(refill_below=1, **chosen), seed)
    for name, *arguments in sequence:
        getattr(session, name)(*arguments)


def test_what_is_refused_leaves_no_trace():
    asked, plain = (Session(TrackerSettings(max_landmarks=30, refill_below=20)) for _ in range(2))
    for session in (asked, plain):
        session.track("drive", 0.1, "none")
        session.track("drive", 0.1, "none")
    for what in ILLEGAL:
        asked.refuse(what)
    for session in (asked, plain):
        session.track("drive", 0.1, "none")
    after, without = asked.last.observation, plain.last.observation
    assert len(after) > 10
    assert np.array_equal(after.ids, without.ids)
    assert np.array_equal(after.uvd, without.uvd)


@settings(drawn, max_examples=25)
@given(
    width=st.integers(1, 70),
    height=st.integers(1, 70),
    focal=st.sampled_from([1.0, 30.0, 3e4]),
    baseline=st.sampled_from([0.01, 0.6, 100.0]),
    offset=st.sampled_from([0.0, 5.0, -100.0]),
    seed=st.integers(0, 2**16),
)
def test_any_size_of_image_and_any_rig(width, height, focal, baseline, offset, seed):
    rig = StereoCamera(focal, focal, 0.5 * width, 0.5 * height, baseline, width, height)
    tracker = StereoTracker(rig, TrackerSettings(disparity_offset=offset))
    world = np.random.default_rng(seed).integers(0, 256, (height, width + 12), dtype=np.uint8)
    for shift in range(4):
        seen = tracker.track(world[:, shift : shift + width], world[:, shift + 8 : shift + 8 + width], 0.1).observation
        assert len(seen) == 0 or np.linalg.eigvalsh(seen.R).min() > 0


@pytest.mark.parametrize("pause", [1e-300, 1e-9, 30.0, 1e300])
def test_the_drive_goes_on_after_a_time_that_no_model_holds_for(pause):
    session = Session(TrackerSettings(max_landmarks=30, refill_below=20))
    for dt in (0.1, 0.1, pause, 0.1, 0.1):
        session.track("drive", dt, "none")
    assert len(session.last.observation) > 15
    step, _ = session.tracker.last_step
    assert step.t == pytest.approx(DrawnStreet(1).step, abs=0.02)
