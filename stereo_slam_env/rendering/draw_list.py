"""Meshes packed for a graphics card, in chunks that can be left out when they are out of sight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from filters.camera import StereoCamera
from filters.validation import BoolArray, FloatArray
from stereo_slam_env.world.meshes import Mesh
from stereo_slam_env.world.scene import Material

VERTEX = np.dtype([("position", "f4", 3), ("normal", "f4", 3), ("texel", "f4", 3), ("color", "u1", 4)])
VERTEX_FORMAT = "3f 3f 3f 3f1 1x1"
"""`VERTEX` in the notation of moderngl."""
_CELL = 6.0
"""m: triangles with their middles in the same square of the ground make a chunk."""


@dataclass(frozen=True, eq=False)
class DrawList:
    """Triangles, ordered by chunk.

    Attributes
    ----------
    vertices : (V,) `VERTEX`
        In the frame of the meshes.
    triangles : (T, 3) uint32
        Vertex indices.
    starts : (C + 1,) int
        Chunk i has the triangles from starts[i] to starts[i + 1] - 1.
    centers, half_sizes : (C, 3)
        Bounding box of each chunk, m.
    """

    vertices: NDArray[np.void]
    triangles: NDArray[np.uint32]
    starts: NDArray[np.int64]
    centers: FloatArray
    half_sizes: FloatArray

    @cached_property
    def radius(self) -> float:
        """Of a ball around the origin with everything in it, m."""
        return float(np.linalg.norm(self.vertices["position"], axis=1).max())

    def front_to_back(self, view: ViewVolume) -> NDArray[np.uint32]:
        """Triangles of the chunks that reach into `view`, the nearest chunks first; (K, 3)."""
        seen = np.flatnonzero(view.touches(self.centers, self.half_sizes))
        order = seen[np.argsort(view.distance(self.centers[seen]), kind="stable")]
        parts = [self.triangles[self.starts[i] : self.starts[i + 1]] for i in order]
        return np.concatenate(parts) if parts else self.triangles[:0]


@dataclass(frozen=True, eq=False)
class ViewVolume:
    """What at least one of two eyes may see: points with normals (6, 3) . p >= offsets (6,)."""

    normals: FloatArray
    offsets: FloatArray
    eye: FloatArray

    @classmethod
    def of(cls, camera: StereoCamera, eye: FloatArray, R_sc: FloatArray, near: float, far: float) -> ViewVolume:
        """Of a rig whose left camera is at `eye` (3,) with rotation `R_sc` (3, 3)."""
        left = (-0.5 - camera.cx) / camera.fx
        right = (camera.width - 0.5 - camera.cx) / camera.fx
        top = (-0.5 - camera.cy) / camera.fy
        bottom = (camera.height - 0.5 - camera.cy) / camera.fy
        normals_c = np.array([[1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom], [0, 0, 1], [0, 0, -1]])
        # The right eye sees further to the right, from a baseline further to the right.
        offsets_c = np.array([0.0, -camera.baseline, 0.0, 0.0, near, -far])
        normals = normals_c @ R_sc.T
        return cls(normals, offsets_c + normals @ eye, eye)

    def touches(self, centers: FloatArray, half_sizes: FloatArray) -> BoolArray:
        """Which upright boxes (..., 3) may reach into it; (...)."""
        reach = centers @ self.normals.T + half_sizes @ np.abs(self.normals.T)
        return np.asarray((reach >= self.offsets).all(axis=-1))

    def distance(self, points: FloatArray) -> FloatArray:
        """From the left eye to points (N, 3); (N,) m."""
        return np.asarray(np.linalg.norm(points - self.eye, axis=1))


def draw_list(meshes: Mapping[Material, Mesh], layer: Callable[[Material], int]) -> DrawList:
    """Pack meshes into one list.

    Parameters
    ----------
    meshes : mapping from Material to Mesh
        As from `world.meshes`.
    layer : callable
        Layer of the texture array that a material is painted with.
    """
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
