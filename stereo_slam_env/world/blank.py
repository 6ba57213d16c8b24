"""A world without texture: the same scene with every surface of one colour."""

from __future__ import annotations

from stereo_slam_env.world.scene import Material, Scene
from stereo_slam_env.world.textures import texture


def without_texture(scene: Scene) -> Scene:
    """The scene with plain surfaces, each in the mean colour of what was on it; shapes, landmarks and light stay.

    What is left to see is where one surface ends and another begins.
    """
    return scene.repainted(_plain)


def _plain(material: Material) -> Material:
    if material.texture is None:
        return material
    mean = texture(material.texture, material.variant).mean(axis=(0, 1)) / 255.0
    red, green, blue = (mean * material.color).tolist()
    return Material((red, green, blue))
