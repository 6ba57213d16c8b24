"""Stereo images by OpenGL, on the graphics card or by Mesa on the CPU: fast, without a display. Needs moderngl."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering import gl_shaders, pinhole
from stereo_slam_env.rendering.draw_list import VERTEX_FORMAT, DrawList, ViewVolume, draw_list
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.meshes import body_meshes, scene_meshes
from stereo_slam_env.world.scene import Look, Material, MovingBody, Scene
from stereo_slam_env.world.textures import Image, texture

NEAR, FAR = 0.5, 300.0
ZENITH_SLOPE = 0.45


class GLRenderer:
    """Draws scenes with OpenGL, both eyes in one frame buffer.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    frame : WorldFrame
        Where W sits in the scene.
    samples : int
        Samples a pixel for smooth edges, 1 or 4; the depth stays that of the pixel centres.

    Raises
    ------
    ImportError
        moderngl is not installed.
    RuntimeError
        There is no EGL.
    """

    def __init__(self, camera: StereoCamera, frame: WorldFrame, samples: int = 1) -> None:
        self.camera = camera
        self._frame = frame
        self._context: Any = _new_context()
        with self._context as context:
            self._textures = _TextureArray(context)
            self._target = _Target(context, camera.width, camera.height, samples)
            self._surfaces = context.program(gl_shaders.SURFACE_VERTEX, gl_shaders.SURFACE_FRAGMENT)
            self._sky = context.program(gl_shaders.SKY_VERTEX, gl_shaders.SKY_FRAGMENT)
            self._sky_array = context.vertex_array(self._sky, [])
            projection = pinhole.projection_matrix(camera, NEAR, FAR, pinhole.OPENGL_OFFSET)
            upside_down = np.diag([1.0, -1.0, 1.0, 1.0]) @ projection @ np.diag([1.0, -1.0, -1.0, 1.0])
            self._surfaces["projection"].write(_columns(upside_down))
        self._standing: _Drawable | None = None
        self._moving: list[tuple[MovingBody, _Drawable]] = []

    def build(self, scene: Scene) -> None:
        """Replace whatever was drawn by `scene`."""
        with self._context as context:
            self._forget()
            meshes = scene_meshes(scene)
            bodies = [body_meshes(body) for body in scene.moving]
            self._textures.load(material for group in (meshes, *bodies) for material in group)
            self._standing = _Drawable(context, self._surfaces, draw_list(meshes, self._textures.layer))
            self._moving = [
                (body, _Drawable(context, self._surfaces, draw_list(group, self._textures.layer)))
                for body, group in zip(scene.moving, bodies, strict=True)
            ]
            self._set_look(scene.look)

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Draw what the rig sees from `pose` (left camera in W) when moving bodies are where they are at `time` s."""
        eye = self._frame.to_scene(pose.position)
        R_sc = self._frame.rotation_to_scene(rotations.matrix(pose.orientation))
        view = ViewVolume.of(self.camera, eye, R_sc, NEAR, FAR)
        with self._context as context:
            self._surfaces["R_cs"].write(_columns(R_sc.T))
            context.front_face = "cw"  # of the upside-down picture
            context.enable_only(context.DEPTH_TEST | context.CULL_FACE)
            context.depth_func = "<="
            self._target.clear()
            self._textures.use()
            assert self._standing is not None
            standing = self._standing.upload(view)
            self._place(np.eye(3), -eye)
            for eye_index in (0, 1):
                self._target.look_with(eye_index)
                self._surfaces["eye"].value = eye_index * self.camera.baseline
                self._standing.draw(standing)
            for body, drawable in self._moving:
                self._draw_body(body, drawable, time, eye)
            for eye_index in (0, 1):
                self._draw_sky(eye_index, R_sc)
            return self._target.read()

    def _draw_body(self, body: MovingBody, drawable: _Drawable, time: float, eye: FloatArray) -> None:
        position, yaw = body.pose_at(time)
        cos, sin = np.cos(yaw), np.sin(yaw)
        self._place(np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), position - eye)
        count = drawable.upload(None)
        for eye_index in (0, 1):
            self._target.look_with(eye_index)
            self._surfaces["eye"].value = eye_index * self.camera.baseline
            drawable.draw(count)

    def _place(self, R_sb: FloatArray, offset: FloatArray) -> None:
        coarse = offset.astype(np.float32)
        self._surfaces["R_sb"].write(_columns(R_sb))
        self._surfaces["from_camera"].write(coarse.tobytes())
        self._surfaces["remainder"].write((offset - coarse).astype(np.float32).tobytes())

    def _draw_sky(self, eye_index: int, R_sc: FloatArray) -> None:
        camera = self.camera
        up = R_sc[2] / ZENITH_SLOPE
        across, down = up[0] / camera.fx, up[1] / camera.fy
        row = eye_index * camera.height
        constant = up[2] - across * (camera.cx + 0.5) - down * (camera.cy + 0.5 + row)
        self._sky["up"].value = (across, down, constant)
        self._target.look_with(eye_index)
        self._sky_array.render(vertices=3)

    def _set_look(self, look: Look) -> None:
        sun = np.array(look.sun) / np.linalg.norm(look.sun)
        horizon = tuple(value / 255.0 for value in look.horizon)
        self._surfaces["sun"].value = tuple(sun)
        self._surfaces["light"].value = (look.ambient, look.diffuse)
        self._surfaces["haze"].value = 1.0 / look.haze_range
        self._surfaces["horizon"].value = self._sky["horizon"].value = horizon
        self._sky["zenith"].value = tuple(value / 255.0 for value in look.zenith)

    def _forget(self) -> None:
        for drawable in [self._standing, *(drawable for _, drawable in self._moving)]:
            if drawable is not None:
                drawable.release()
        self._standing, self._moving = None, []

    def close(self) -> None:
        """Free the context; may be called twice."""
        if self._context is None:
            return
        with self._context:
            self._forget()
            self._target.release()
            self._textures.release()
            self._sky_array.release()
            self._sky.release()
            self._surfaces.release()
        self._context.release()
        self._context = None


def _columns(matrix: FloatArray) -> bytes:
    return matrix.astype(np.float32).tobytes(order="F")


def _new_context() -> Any:
    try:
        import moderngl
    except ImportError as error:
        raise ImportError('renderer "gl" needs moderngl: pip install "stereo-slam-env[gl]"') from error
    # One thread: parallelism comes from whole runs, and threads of Mesa would not survive a fork.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    try:
        context = moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:
        raise RuntimeError(
            f'renderer "gl" found no EGL ({error}): install libegl1 and libgl1-mesa-dri, or use renderer="tiny"'
        ) from error
    context.gc_mode = None
    return context


class _Drawable:
    """A draw list on the card."""

    def __init__(self, context: Any, program: Any, content: DrawList) -> None:
        self._content = content
        self._vertices = context.buffer(content.vertices.tobytes())
        self._indices = context.buffer(content.triangles.tobytes(), dynamic=True)
        attributes = ("position", "normal", "texel", "color")
        self._array = context.vertex_array(
            program, [(self._vertices, VERTEX_FORMAT, *attributes)], index_buffer=self._indices
        )

    def upload(self, view: ViewVolume | None) -> int:
        if view is None:
            return int(self._content.triangles.size)
        triangles = self._content.front_to_back(view)
        self._indices.orphan()
        if triangles.size:
            self._indices.write(triangles)
        return int(triangles.size)

    def draw(self, count: int) -> None:
        if count:
            self._array.render(vertices=count)

    def release(self) -> None:
        for thing in (self._array, self._indices, self._vertices):
            thing.release()


class _TextureArray:
    """The textures in use, all brought to the size of the largest, in one array: everything is one draw call."""

    _PLAIN = ("", 0)

    def __init__(self, context: Any) -> None:
        self._context = context
        self._array: Any = None
        self._layers: dict[tuple[str, int], int] = {}

    def layer(self, material: Material) -> int:
        return self._layers[self._key(material)]

    def load(self, materials: Iterable[Material]) -> None:
        wanted = {self._key(material) for material in materials} | {self._PLAIN}
        if wanted <= self._layers.keys():
            return
        keys = sorted(wanted | self._layers.keys())
        images = [np.full((1, 1, 3), 255, np.uint8) if key == self._PLAIN else texture(*key) for key in keys]
        size = max(max(image.shape[:2]) for image in images)
        self.release()
        pixels = np.stack([_rgba(_enlarged(image, size)) for image in images])
        self._array = self._context.texture_array((size, size, len(keys)), 4, pixels)
        self._array.build_mipmaps()
        self._array.filter = (self._context.LINEAR_MIPMAP_LINEAR, self._context.LINEAR)
        self._array.repeat_x = self._array.repeat_y = True
        self._layers = {key: i for i, key in enumerate(keys)}

    def use(self) -> None:
        self._array.use(0)

    def release(self) -> None:
        if self._array is not None:
            self._array.release()
        self._array = None

    def _key(self, material: Material) -> tuple[str, int]:
        return self._PLAIN if material.texture is None else (material.texture, material.variant)


def _rgba(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image[::-1], cv2.COLOR_RGB2RGBA), dtype=np.uint8)


def _enlarged(image: Image, size: int) -> Image:
    """Interpolated as the card would, across the seams of the repeats as well."""
    if image.shape[:2] == (size, size):
        return image
    wrapped = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    height, width = image.shape[:2]
    rows = (np.arange(size, dtype=np.float32) + 0.5) * (height / size) + 0.5
    columns = (np.arange(size, dtype=np.float32) + 0.5) * (width / size) + 0.5
    return np.asarray(cv2.remap(wrapped, *np.meshgrid(columns, rows), cv2.INTER_LINEAR), dtype=np.uint8)


class _Target:
    """The frame buffer: the left eye above the right one."""

    def __init__(self, context: Any, width: int, height: int, samples: int) -> None:
        self._context, self._size = context, (width, height)
        size = (width, 2 * height)
        self._parts = [context.renderbuffer(size, 4), context.depth_renderbuffer(size)]
        self._buffer = context.framebuffer([self._parts[0]], self._parts[1])

    def clear(self) -> None:
        self._buffer.use()
        self._buffer.clear(depth=1.0)

    def look_with(self, eye_index: int) -> None:
        width, height = self._size
        self._buffer.viewport = (0, eye_index * height, width, height)

    def read(self) -> StereoImages:
        width, height = self._size
        rgba: NDArray[np.uint8] = np.empty((2 * height, width, 4), dtype=np.uint8)
        self._buffer.read_into(rgba, (0, 0, width, 2 * height), components=4)
        buffer: NDArray[np.float32] = np.empty((height, width), dtype=np.float32)
        self._buffer.read_into(buffer, (0, 0, width, height), components=1, attachment=-1, dtype="f4")
        rgb = np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), dtype=np.uint8)
        return StereoImages(rgb[:height], rgb[height:], pinhole.metric_depth(buffer, NEAR, FAR))

    def release(self) -> None:
        for thing in (self._buffer, *self._parts):
            thing.release()
