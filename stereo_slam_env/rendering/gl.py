"""Stereo images by OpenGL, on a graphics card or by Mesa on the CPU: fast, without a display. Needs moderngl.

Row 0 of the frame buffer is row 0 of the image, so nothing has to be flipped when it is read.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.gl_resources import (
    FrameBuffer,
    MeshBuffer,
    TextureArray,
    ViewVolume,
    check_process,
    draw_list,
    new_context,
)
from stereo_slam_env.rendering.pinhole import FAR, NEAR, ImageQuality, StereoImages, sky_slope
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.meshes import body_meshes, scene_meshes
from stereo_slam_env.world.scene import MovingBody, Scene

SURFACE_VERTEX = """
#version 330
uniform mat3 R_sb;         // from the frame of the body to S; the identity for what stands still
uniform vec3 from_camera;  // origin of the body minus the left camera, in S; in two parts so that single precision
uniform vec3 remainder;    // is enough far from the origin
uniform mat3 R_cs;
uniform float shift;       // of the camera that looks along the x axis of the left one
uniform mat4 projection;
uniform vec3 sun;          // unit vector in S
uniform vec2 light;        // ambient, diffuse
in vec3 position;
in vec3 normal;
in vec3 texel;             // u, v, layer
in vec3 color;
out vec3 at_texel;
out vec3 tint;
void main() {
    vec3 p_c = R_cs * ((R_sb * position + from_camera) + remainder);
    gl_Position = projection * vec4(p_c.x - shift, p_c.yz, 1.0);
    at_texel = texel;
    tint = color * (light.x + light.y * max(0.0, dot(R_sb * normal, sun)));
}
"""

SURFACE_FRAGMENT = """
#version 330
uniform sampler2DArray textures;
uniform vec3 horizon;
uniform float haze;        // 1/m
in vec3 at_texel;
in vec3 tint;
out vec4 shade;
void main() {
    vec3 lit = min(texture(textures, at_texel).rgb * tint, 1.0);
    shade = vec4(mix(horizon, lit, exp(-haze / gl_FragCoord.w)), 1.0);
}
"""

SKY_VERTEX = """
#version 330
void main() {  // one triangle over everything, as far away as can be
    gl_Position = vec4(gl_VertexID == 2 ? 3.0 : -1.0, gl_VertexID == 1 ? 3.0 : -1.0, 1.0, 1.0);
}
"""

SKY_FRAGMENT = """
#version 330
uniform vec3 slope;        // of the ray through a place in the frame buffer: slope.x * x + slope.y * y + slope.z
uniform vec3 horizon;
uniform vec3 zenith;
out vec4 shade;
void main() {
    float height = sqrt(clamp(dot(slope, vec3(gl_FragCoord.xy, 1.0)), 0.0, 1.0));
    shade = vec4(mix(horizon, zenith, height), 1.0);
}
"""


Placed = tuple[MeshBuffer, FloatArray, FloatArray]
"""A mesh with R_sb of its frame, and the origin of that minus the left camera, in S."""


class GLRenderer:
    """Draws scenes with OpenGL, both views in one frame buffer; see `make_renderer` for arguments and errors.

    Several can live in one process. In a process that was forked from one that had drawn with OpenGL, drawing is
    refused.
    """

    def __init__(self, camera: StereoCamera, frame: WorldFrame, supersample: int = 1, samples: int = 1) -> None:
        self.camera = camera
        self._frame = frame
        self._fine = pinhole.supersampled(camera, supersample)
        self._context: Any = new_context()
        self._free = weakref.finalize(self, self._context.release)
        most = int(self._context.max_samples)
        if not 1 <= samples <= most:
            self.close()
            raise ValueError(f"samples must be from 1 to {most} with this driver, got {samples!r}")
        with self._context as context:
            self._frame_buffer = FrameBuffer(context, camera, supersample, samples)
            self._textures = TextureArray(context)
            self._surface = context.program(SURFACE_VERTEX, SURFACE_FRAGMENT)
            self._sky = context.program(SKY_VERTEX, SKY_FRAGMENT)
            self._everywhere = context.vertex_array(self._sky, [])
            self._surface["projection"].write(_single(_projection(camera)))
        self._standing: MeshBuffer | None = None
        self._moving: list[tuple[MovingBody, MeshBuffer]] = []

    @staticmethod
    def image_quality(supersample: int = 1) -> ImageQuality:
        """Blur of the images, measured by the slide of tracks (docs/front_end.md)."""
        return ImageQuality(blur=1.0 if supersample == 1 else 0.4)

    def build(self, scene: Scene) -> None:
        """Replace whatever was drawn by `scene`."""
        standing = scene_meshes(scene)
        moving = [body_meshes(body) for body in scene.moving]
        with self._current() as context:
            for mesh in [self._standing, *(mesh for _, mesh in self._moving)]:
                if mesh is not None:
                    mesh.release()
            self._standing, self._moving = None, []
            self._textures.load(material for meshes in (standing, *moving) for material in meshes)
            buffers = [
                MeshBuffer(context, self._surface, draw_list(meshes, self._textures.layer))
                for meshes in (standing, *moving)
            ]
            self._standing, self._moving = buffers[0], list(zip(scene.moving, buffers[1:], strict=True))
            look = scene.look
            horizon, zenith = (tuple(value / 255.0 for value in color) for color in (look.horizon, look.zenith))
            self._surface["sun"].value = tuple(np.array(look.sun) / np.linalg.norm(look.sun))
            self._surface["light"].value = (look.ambient, look.diffuse)
            self._surface["haze"].value = 1.0 / look.haze_range
            self._surface["horizon"].value = self._sky["horizon"].value = horizon
            self._sky["zenith"].value = zenith

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Raise a RuntimeError where there is no scene yet, or the renderer is closed."""
        position = self._frame.to_scene(pose.position)
        R_sc = self._frame.rotation_to_scene(rotations.matrix(pose.orientation))
        view = ViewVolume.of(self.camera, position, R_sc, NEAR, FAR)
        with self._current() as context:
            if self._standing is None:
                raise RuntimeError("there is nothing to draw: call build(scene) first")
            self._standing.select(view)
            things = [(self._standing, np.eye(3), -position), *self._moving_in(view, time)]
            context.enable_only(context.DEPTH_TEST | context.CULL_FACE)
            context.depth_func, context.front_face = "<=", "cw"  # clockwise because the picture is upside down
            self._textures.use()
            self._surface["R_cs"].write(_single(R_sc.T))
            self._frame_buffer.clear()
            for index in (0, 1):
                self._frame_buffer.draw_view(index)
                self._draw_surfaces(things, index)
                self._draw_sky(R_sc, index)
            if self._frame_buffer.separate_depth:
                self._frame_buffer.draw_depth()
                self._draw_surfaces(things, 0)
            return self._frame_buffer.read()

    def close(self) -> None:
        """Free the context and with it all that is in it; may be called twice. Also happens to one that is dropped."""
        self._free()

    @contextmanager
    def _current(self) -> Iterator[Any]:
        """Make the context of this renderer current, and afterwards again the one that was."""
        if not self._free.alive:
            raise RuntimeError("the renderer is closed: make a new one")
        check_process()
        with self._context as context:
            yield context

    def _moving_in(self, view: ViewVolume, time: float) -> list[Placed]:
        placed: list[Placed] = []
        for body, mesh in self._moving:
            position, yaw = body.pose_at(time)
            if view.touches(position, np.full(3, mesh.content.radius)):
                cos, sin = np.cos(yaw), np.sin(yaw)
                R_sb = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
                placed.append((mesh, R_sb, position - view.position))
        return placed

    def _draw_surfaces(self, things: Sequence[Placed], side: int) -> None:
        self._surface["shift"].value = side * self.camera.baseline
        for mesh, R_sb, from_camera in things:
            coarse = from_camera.astype(np.float32)
            self._surface["R_sb"].write(_single(R_sb))
            self._surface["from_camera"].write(coarse)
            self._surface["remainder"].write((from_camera - coarse).astype(np.float32))
            mesh.draw()

    def _draw_sky(self, R_sc: FloatArray, side: int) -> None:
        a, b, c = sky_slope(self._fine, R_sc)
        top = side * self._fine.height
        self._sky["slope"].value = (a, b, c - 0.5 * a - (0.5 + top) * b)
        self._everywhere.render(vertices=3)


def _projection(camera: StereoCamera) -> FloatArray:
    """Matrix from the camera frame to clip coordinates, with row 0 of the image at the bottom; (4, 4)."""
    opengl = pinhole.projection_matrix(camera, NEAR, FAR, pinhole.OPENGL_OFFSET)
    return np.diag([1.0, -1.0, 1.0, 1.0]) @ opengl @ np.diag([1.0, -1.0, -1.0, 1.0])


def _single(matrix: FloatArray) -> bytes:
    """The matrix in single precision, columns first."""
    return matrix.astype(np.float32).tobytes(order="F")
