"""The picture of active search shows each outcome where it happened (1 s)."""

import cv2
import numpy as np
import pytest

from filters.contract.inputs import StereoObservation
from stereo_slam_env.frontend.tracks import Outcome, Search, TrackedPair
from stereo_slam_env.viewer.search_view import search_picture

HEIGHT, WIDTH = 300, 700  # no enlarging
PEN = 2.5
"""Half the width of an outline with its soft edge, px."""
GREY = np.full((HEIGHT, WIDTH), 128, dtype=np.uint8)


def tracked(searches=(), measured=(), initialised=()):
    """Searches are (id, predicted, S, found, outcome), measurements (id, uvd)."""
    ids, predicted, S, found, outcome = zip(*searches, strict=True) if searches else ((), (), (), (), ())
    search = Search(
        np.array(ids, dtype=np.int64),
        np.array(predicted, dtype=float).reshape(-1, 3),
        np.array(S, dtype=float).reshape(-1, 3, 3),
        np.array(found, dtype=float).reshape(-1, 3),
        np.array(outcome, dtype=np.int64),
    )
    observation = StereoObservation([i for i, _ in measured], np.array([uvd for _, uvd in measured]).reshape(-1, 3))
    none = np.zeros(0, dtype=np.int64)
    corners = StereoObservation(none, np.zeros((0, 3)))
    R = np.tile(np.eye(3), (len(observation), 1, 1))
    return TrackedPair(
        observation.ids, observation.uvd, R, search, corners, np.array(initialised, dtype=np.int64), none
    )


def changes(pair, **options):
    """Where the views differ from those without marks, in coordinates of the left and the right view."""
    empty, marked = (search_picture(GREY, GREY, t, **options) for t in (tracked(), pair))
    bar = 40 if WIDTH >= 1344 else int(40 * WIDTH / 1344)
    different = (empty != marked).any(axis=2)
    return different[bar : bar + HEIGHT], different[bar + HEIGHT + 3 : bar + 2 * HEIGHT + 3]


def extent(mask):
    rows, columns = np.nonzero(mask)
    return columns.min(), columns.max(), rows.min(), rows.max()


def test_ellipses_have_three_sigma_of_what_is_searched_in_each_eye():
    S = np.array([[100.0, 0.0, 60.0], [0.0, 25.0, 0.0], [60.0, 0.0, 144.0]])
    left, right = changes(tracked([(1, (400.0, 150.0, 100.0), S, [np.nan] * 3, Outcome.NO_MATCH)]))
    u0, u1, v0, v1 = extent(left)
    assert (u0, u1) == (pytest.approx(370 - PEN, abs=1), pytest.approx(430 + PEN, abs=1))
    assert (v0, v1) == (pytest.approx(135 - PEN, abs=1), pytest.approx(165 + PEN, abs=1))
    # var(u - d) = 100 + 144 - 2 * 60
    u0, u1, _, _ = extent(right)
    reach = 3 * np.sqrt(124.0)
    assert (u0, u1) == (pytest.approx(300 - reach - PEN, abs=1), pytest.approx(300 + reach + PEN, abs=1))


def test_matches_are_dots_at_the_measurement_and_new_ones_have_their_disparity_drawn():
    left, right = changes(tracked(measured=[(3, (400.0, 150.0, 40.0))]))
    assert np.mean(extent(left)[:2]) == pytest.approx(400, abs=0.6)
    assert np.mean(extent(right)[:2]) == pytest.approx(360, abs=0.6)
    left, right = changes(tracked(measured=[(3, (400.0, 150.0, 40.0))], initialised=[3]))
    assert extent(left)[0] == pytest.approx(360, abs=2)
    assert extent(right)[0] > 350


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome is not Outcome.MATCHED])
def test_every_outcome_has_a_mark_of_its_own_colour_and_a_count(outcome):
    search = (1, (400.0, 150.0, 40.0), np.eye(3), [np.nan] * 3, outcome)
    pictures = {o: search_picture(GREY, GREY, tracked([(*search[:4], o)])) for o in Outcome}
    for other in Outcome:
        same = np.array_equal(pictures[outcome], pictures[other])
        assert same == (other is outcome)


def test_what_was_found_is_marked_there_and_not_where_it_was_expected():
    S = 1e-6 * np.eye(3)
    left, _ = changes(tracked([(1, (400.0, 150.0, 40.0), S, (470.0, 150.0, 40.0), Outcome.INCONSISTENT)]))
    assert left[145:156, 463:478].any()
    # found in the left image alone: the right one shows where it was expected
    _, right = changes(tracked([(1, (400.0, 150.0, 40.0), S, (470.0, 150.0, np.nan), Outcome.NO_DISPARITY)]))
    assert extent(right)[0] == pytest.approx(360, abs=8)


def test_the_picture_keeps_its_size_whatever_was_found_and_small_views_are_enlarged():
    """A video needs pictures of one size."""
    searches = [(i, (50.0 + 5 * i, 150.0, 20.0), np.eye(3), [np.nan] * 3, i % 5 + 1) for i in range(120)]
    for width, wide in ((320, 2 * 640 + 3), (700, 700), (1344, 1344)):
        image = np.zeros((240, width), dtype=np.uint8)
        shapes = {search_picture(image, image, t, ["a"]).shape for t in (tracked(), tracked(searches))}
        assert [shape[1] for shape in shapes] == [wide]
    small = np.zeros((240, 320), dtype=np.uint8)
    assert search_picture(small, small, tracked(), zoom=1).shape[1] == 2 * 320 + 3


def test_nothing_finite_far_outside_or_without_size_breaks_it():
    odd = [
        (1, (1e9, -1e9, 5.0), np.eye(3), [np.nan] * 3, Outcome.OUT_OF_VIEW),
        (2, [np.nan] * 3, np.full((3, 3), np.nan), [np.nan] * 3, Outcome.OUT_OF_VIEW),
        (3, (10.0, 10.0, 5.0), np.zeros((3, 3)), (10.0, 10.0, 5.0), Outcome.MATCHED),
        (4, (10.0, 10.0, 5.0), 1e12 * np.eye(3), [np.nan] * 3, Outcome.NO_MATCH),
    ]
    search_picture(GREY, GREY, tracked(odd, measured=[(3, (10.0, 10.0, -2.0))]))
    assert (GREY == 128).all()


def test_colour_images_are_not_taken():
    with pytest.raises(cv2.error):
        search_picture(np.zeros((10, 10, 3), dtype=np.uint8), GREY, tracked())
