"""Renderers by name, and what identifies them."""

import json

import pytest

from stereo_slam_env.rendering.renderers import image_quality, make_renderer, renderer_identity

from .planes import CAMERA, FRAME, both_back_ends, skip_where_missing


def make(name, **options):
    return make_renderer(name, camera=CAMERA, frame=FRAME, **options)


@both_back_ends
def test_the_identity_says_what_drew(name):
    skip_where_missing(name)
    identity = renderer_identity(name)
    assert identity["name"] == name
    assert all(identity[key] for key in ("version", "device"))
    assert json.loads(json.dumps(identity)) == identity


@pytest.mark.parametrize("ask", [make, renderer_identity, image_quality])
def test_an_unknown_renderer_is_refused_by_name(ask):
    with pytest.raises(ValueError, match="renderer must be one of tiny, gl, got 'vulkan'"):
        ask("vulkan")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"supersample": 0}, "supersample must be a whole number from 1, got 0"),
        ({"supersample": 1.5}, "supersample must be a whole number from 1, got 1.5"),
        ({"samples": 4}, 'samples must be 1 with renderer "tiny", got 4'),
    ],
)
def test_what_a_renderer_cannot_do_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        make("tiny", **options)


def test_a_renderer_states_the_blur_of_its_images_and_what_supersampling_changes():
    assert image_quality("gl").blur == 1.0
    assert 0.0 < image_quality("gl", supersample=2).blur < 1.0
    assert image_quality("tiny").blur == 0.0
    assert image_quality("tiny").texture_sigma > image_quality("gl").texture_sigma == 0.0
