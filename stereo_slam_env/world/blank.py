"""A world without texture: the same scene with every surface of one colour."""

from __future__ import annotations

from stereo_slam_env.world.scene import Material, Scene

BLANK = Material((0.75, 0.75, 0.75))
"""Light grey, so that the sunny side is not yet white."""


def without_texture(scene: Scene) -> Scene:
    """The scene with everything in it of one plain colour; shapes, landmarks, light and air stay.

    What is left to see is light and shade: where two surfaces meet that the sun lights differently, and outlines
    against what is hazier.
    """
    return scene.repainted(lambda material: BLANK)
