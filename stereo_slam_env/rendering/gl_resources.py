"""Resources of the GL back end: meshes packed in chunks, textures, a context and a frame buffer."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.contract.extras import install_command
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.pinhole import StereoImages
from stereo_slam_env.world.meshes import Mesh
from stereo_slam_env.world.scene import Material
from stereo_slam_env.world.street_textures import Image, texture

VERTEX = np.dtype([("position", "f4", 3), ("normal", "f4", 3), ("texel", "f4", 3), ("color", "u1", 4)])
VERTEX_FORMAT = "3f 3f 3f 3f1 1x1"
"""`VERTEX` in the notation of moderngl."""
_CELL = 6.0
"""m: triangles with their middles in the same square of the ground make a chunk."""


@dataclass(frozen=True, eq=False)
class DrawList:
    """Triangles, ordered by chunk: vertices in the frame of the meshes, (T, 3) vertex indices.

    Chunk i of C has the triangles from starts[i] to starts[i + 1] - 1; `centers` and `half_sizes` (C, 3) are of its
    bounding box, m.
    """

    vertices: NDArray[np.void]
    triangles: NDArray[np.uint32]
    starts: NDArray[np.int64]
    centers: FloatArray
    half_sizes: FloatArray

    @cached_property
    def radius(self) -> float:
        """Radius of a ball around the origin with everything in it, m."""
        return float(np.linalg.norm(self.vertices["position"], axis=1).max())

    def front_to_back(self, view: ViewVolume) -> NDArray[np.uint32]:
        """Triangles of the chunks that reach into `view`, the nearest chunks first; (K, 3)."""
        visible = np.flatnonzero(view.touches(self.centers, self.half_sizes))
        away = np.linalg.norm(self.centers[visible] - view.position, axis=1)
        order = visible[np.argsort(away, kind="stable")]
        parts = [self.triangles[self.starts[i] : self.starts[i + 1]] for i in order]
        return np.concatenate(parts) if parts else self.triangles[:0]


@dataclass(frozen=True, eq=False)
class ViewVolume:
    """Volume that at least one of the two cameras may see: points with normals (6, 3) . p >= offsets (6,)."""

    normals: FloatArray
    offsets: FloatArray
    position: FloatArray

    @classmethod
    def of(cls, camera: StereoCamera, position: FloatArray, R_sc: FloatArray, near: float, far: float) -> ViewVolume:
        """Volume of a rig whose left camera is at `position` (3,) with rotation `R_sc` (3, 3)."""
        left = (-0.5 - camera.cx) / camera.fx
        right = (camera.width - 0.5 - camera.cx) / camera.fx
        top = (-0.5 - camera.cy) / camera.fy
        bottom = (camera.height - 0.5 - camera.cy) / camera.fy
        normals_c = np.array([[1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom], [0, 0, 1], [0, 0, -1]])
        # The right camera sees further to the right, from a baseline further to the right.
        offsets_c = np.array([0.0, -camera.baseline, 0.0, 0.0, near, -far])
        normals = normals_c @ R_sc.T
        return cls(normals, offsets_c + normals @ position, position)

    def touches(self, centers: FloatArray, half_sizes: FloatArray) -> BoolArray:
        """Mask (...) of upright boxes (..., 3) that may reach into it."""
        reach = centers @ self.normals.T + half_sizes @ np.abs(self.normals.T)
        return np.asarray((reach >= self.offsets).all(axis=-1))


def draw_list(meshes: Mapping[Material, Mesh], layer: Callable[[Material], int]) -> DrawList:
    """Pack meshes into one list; `layer` tells in which layer of the texture array a material is."""
    vertices = np.concatenate([_packed(mesh, material, layer(material)) for material, mesh in meshes.items()])
    shifts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes.values()])
    triangles = np.concatenate([m.triangles + s for m, s in zip(meshes.values(), shifts[:-1], strict=True)])
    corners = vertices["position"][triangles].astype(np.float64)
    cells = np.floor(corners[:, :, :2].mean(axis=1) / _CELL).astype(np.int64)
    order = np.lexsort((cells[:, 1], cells[:, 0]))
    cells, corners = cells[order], corners[order]
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(cells, axis=0) != 0).any(axis=1)]))
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    ends = np.concatenate([starts, [len(triangles)]])
    return DrawList(vertices, triangles[order].astype(np.uint32), ends, 0.5 * (low + high), 0.5 * (high - low))


def _packed(mesh: Mesh, material: Material, layer: int) -> NDArray[np.void]:
    packed = np.zeros(len(mesh.vertices), dtype=VERTEX)
    packed["position"], packed["normal"] = mesh.vertices, mesh.normals
    packed["texel"][:, :2], packed["texel"][:, 2] = mesh.uvs, layer
    packed["color"][:, :3] = np.rint(255 * np.clip(material.color, 0.0, 1.0))
    return packed


@cache
def _first_process() -> int:
    """The process that first used OpenGL, also in those that are forked from it."""
    return os.getpid()


def check_process() -> None:
    """Raise a RuntimeError in a fork of a process that had used OpenGL: threads of the driver do not survive it.

    Mesa has one for its cache of shaders, even where `LP_NUM_THREADS` is 0.
    """
    if _first_process() != os.getpid():
        raise RuntimeError(
            'renderer "gl" was used before this process was forked, and its threads do not survive that: '
            'start processes with the method "forkserver" or "spawn"'
        )


def _load_triton() -> None:
    """Load Triton, where it is installed, before Mesa loads its LLVM: loaded after it, Triton ends the process.

    PyTorch built for CUDA brings Triton (seen: 3.7.1 with LLVM 15 of Mesa, segmentation fault) and loads it late.
    """
    with suppress(ImportError):
        import_module("triton")


def new_context() -> Any:
    """A context of moderngl without a window; errors as of `make_renderer`."""
    try:
        moderngl: Any = import_module("moderngl")
    except ImportError as error:
        raise ImportError(f'renderer "gl" needs moderngl: {install_command("gl")}') from error
    # Mesa on the CPU draws without threads: parallelism comes from whole runs.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    check_process()
    _load_triton()
    try:
        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # whatever the platform raises
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RuntimeError(
            f'renderer "gl" found no EGL ({reason}): apt install libegl1 libgl1-mesa-dri, or use renderer="tiny"'
        ) from error


def device() -> dict[str, str]:
    """`version` of OpenGL and the `device` that draws."""
    context = new_context()
    try:
        return {"version": str(context.info["GL_VERSION"]), "device": str(context.info["GL_RENDERER"])}
    finally:
        context.release()


class MeshBuffer:
    """A draw list on the card."""

    def __init__(self, context: Any, program: Any, content: DrawList) -> None:
        self.content = content
        self._vertices = context.buffer(content.vertices.tobytes())
        self._indices = context.buffer(content.triangles.tobytes(), dynamic=True)
        layout = (self._vertices, VERTEX_FORMAT, *(content.vertices.dtype.names or ()))
        self._array = context.vertex_array(program, [layout], index_buffer=self._indices)
        self._count = content.triangles.size

    def select(self, view: ViewVolume) -> None:
        """Draw only what may be seen in `view`."""
        triangles = self.content.front_to_back(view)
        self._count = triangles.size
        self._indices.orphan()
        if self._count:
            self._indices.write(triangles)

    def draw(self) -> None:
        """Draw with the program as it is set."""
        if self._count:
            self._array.render(vertices=self._count)

    def release(self) -> None:
        """Free the memory of the graphics context."""
        for thing in (self._array, self._indices, self._vertices):
            thing.release()


class TextureArray:
    """The textures in use, all brought to the size of the largest, in one array: a scene is one draw call."""

    _PLAIN = ("", 0)

    def __init__(self, context: Any) -> None:
        self._context = context
        self._array: Any = None
        self._layers: dict[tuple[str, int], int] = {}

    def layer(self, material: Material) -> int:
        """File of the texture of a loaded material."""
        return self._layers[self._key(material)]

    def load(self, materials: Iterable[Material]) -> None:
        """Make sure that the textures of `materials` are there; those from before stay."""
        wanted_keys = {self._key(material) for material in materials} | {self._PLAIN}
        if wanted_keys <= self._layers.keys():
            return
        keys = sorted(wanted_keys | self._layers.keys())
        images = [np.full((1, 1, 3), 255, np.uint8) if key == self._PLAIN else texture(*key) for key in keys]
        size = max(max(image.shape[:2]) for image in images)
        # With alpha and the bottom row first, as OpenGL wants it.
        pixels = np.stack([cv2.cvtColor(_enlarged(image, size)[::-1], cv2.COLOR_RGB2RGBA) for image in images])
        if self._array is not None:
            self._array.release()
        self._array = self._context.texture_array((size, size, len(keys)), 4, pixels)
        self._array.build_mipmaps()
        # Never with anisotropic filtering: on the CPU it takes several times longer than all the rest.
        self._array.filter = (self._context.LINEAR_MIPMAP_LINEAR, self._context.LINEAR)
        self._layers = {key: i for i, key in enumerate(keys)}

    def use(self) -> None:
        """Put it where the shaders look for it."""
        self._array.use(0)

    def _key(self, material: Material) -> tuple[str, int]:
        return self._PLAIN if material.texture is None else (material.texture, material.variant)


def _enlarged(image: Image, size: int) -> Image:
    """Interpolated as the card would do it, across the seam between two repeats as well."""
    height, width = image.shape[:2]
    if (height, width) == (size, size):
        return image
    wrapped = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    middle = np.arange(size, dtype=np.float32) + np.float32(0.5)
    columns, rows = np.meshgrid(middle * (width / size) + 0.5, middle * (height / size) + 0.5)
    return np.asarray(cv2.remap(wrapped, columns, rows, cv2.INTER_LINEAR), dtype=np.uint8)


class FrameBuffer:
    """Frame buffer for both views, the left one above the right one."""

    def __init__(self, context: Any, camera: StereoCamera, supersample: int, samples: int) -> None:
        self._context, self._factor = context, supersample
        self._size = (camera.width, camera.height)
        self._fine = (camera.width * supersample, camera.height * supersample)
        both = (self._fine[0], 2 * self._fine[1])
        many = samples if samples > 1 else 0
        self._parts = [context.renderbuffer(both, 4, samples=many), context.depth_renderbuffer(both, samples=many)]
        self._drawn = self._resolved = self._centres = context.framebuffer(self._parts[:1], self._parts[1])
        self.separate_depth = samples > 1 or supersample > 1
        """Whether depth has to be drawn apart, because the pixel centres are not what is drawn."""
        if samples > 1:
            self._parts.append(context.renderbuffer(both, 4))
            self._resolved = context.framebuffer(self._parts[-1:])
        if self.separate_depth:
            self._parts.append(context.depth_renderbuffer(self._size))
            self._centres = context.framebuffer([], self._parts[-1])

    def clear(self) -> None:
        """Clear what was drawn."""
        for buffer in {self._drawn, self._centres}:
            buffer.clear(depth=1.0)

    def draw_view(self, index: int) -> None:
        """Select the left (0) or the right (1) view as what is drawn into."""
        self._drawn.use()
        self._drawn.viewport = (0, index * self._fine[1], *self._fine)

    def draw_depth(self) -> None:
        """Select the depth of the left view as what is drawn into."""
        self._centres.use()
        self._centres.viewport = (0, 0, *self._size)

    def read(self) -> StereoImages:
        """Drawn image pair, read back."""
        if self._resolved is not self._drawn:
            self._context.copy_framebuffer(self._resolved, self._drawn)
        width, height = self._fine
        rgba: NDArray[np.uint8] = np.empty((2 * height, width, 4), dtype=np.uint8)
        self._resolved.read_into(rgba, (0, 0, width, 2 * height), components=4)
        rgb = pinhole.averaged(np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), dtype=np.uint8), self._factor)
        width, height = self._size
        buffer: NDArray[np.float32] = np.empty((height, width), dtype=np.float32)
        self._centres.read_into(buffer, (0, 0, width, height), components=1, attachment=-1, dtype="f4")
        return StereoImages(rgb[:height], rgb[height:], pinhole.metric_depth(buffer, pinhole.NEAR, pinhole.FAR))
