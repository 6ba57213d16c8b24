"""Triangle meshes of a scene for renderers, one for each material."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, singledispatch

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.scene import (
    Box,
    Cylinder,
    Ground,
    Material,
    MovingBody,
    Primitive,
    Ribbon,
    Scene,
    Sphere,
    TriangleMesh,
)

_GROUND_CELL = 47.3
_SEGMENTS = 12
_LARGE = 10.0
"""A ball of this radius has finer segments, m."""
_MATERIAL = "look"
Drawn = Ground | Ribbon | Primitive


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles (T, 3) in S, or in the frame of a moving body, counter-clockwise from outside.

    Vertices (V, 3), m, with unit outward normals (V, 3) and texture coordinates >= 0 in repeats (V, 2): u along, v up.
    """

    vertices: FloatArray
    normals: FloatArray
    uvs: FloatArray
    triangles: NDArray[np.int64]


def scene_meshes(scene: Scene) -> dict[Material, Mesh]:
    """One mesh in S for each material of what stands still in the scene."""
    return _by_material((scene.ground, *scene.ribbons, *scene.primitives))


def body_meshes(body: MovingBody) -> dict[Material, Mesh]:
    """One mesh in the frame of the body for each of its materials; `body.pose_at(time)` tells where that is."""
    return _by_material(body.parts)


def _by_material(shapes: Sequence[Drawn]) -> dict[Material, Mesh]:
    parts: defaultdict[Material, list[Mesh]] = defaultdict(list)
    for shape in shapes:
        parts[shape.material].append(mesh(shape))
    return {material: _merged(meshes) for material, meshes in parts.items()}


@singledispatch
def mesh(shape: object) -> Mesh:
    """Triangles of one shape of `world.scene`."""
    raise TypeError(f"no mesh for a {type(shape).__name__}")


@mesh.register
def _box(shape: Box) -> Mesh:
    unit, spans = _unit_box()
    size = np.array(shape.size)
    cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    uvs = unit.uvs * (spans @ size).reshape(-1, 2) / shape.material.tile
    return Mesh((unit.vertices * size) @ R.T + shape.center, unit.normals @ R.T, uvs, unit.triangles)


@mesh.register
def _cylinder(shape: Cylinder) -> Mesh:
    unit = _unit_cylinder()
    start, axis = np.array(shape.start), np.subtract(shape.end, shape.start)
    length = float(np.linalg.norm(axis))
    along = axis / length
    across = np.array([-along[1], along[0], 0.0]) if abs(along[2]) < 0.9 else np.array([0.0, along[2], -along[1]])
    across /= np.linalg.norm(across)
    R = np.column_stack([across, np.cross(along, across), along])
    local = unit.vertices * [shape.radius, shape.radius, length]
    uvs = unit.uvs * [shape.radius, length] / shape.material.tile
    return Mesh(local @ R.T + start, unit.normals @ R.T, uvs, unit.triangles)


@mesh.register
def _sphere(shape: Sphere) -> Mesh:
    unit = _unit_sphere(_SEGMENTS if shape.radius < _LARGE else 4 * _SEGMENTS)
    uvs = unit.uvs * shape.radius / shape.material.tile
    return Mesh(shape.radius * unit.vertices + shape.center, unit.normals, uvs, unit.triangles)


@mesh.register
def _triangle_mesh(shape: TriangleMesh) -> Mesh:
    corners = shape.vertices[shape.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    # Textures are projected along the axis that a triangle faces most, as on the sides of a box.
    axes = np.array([[1, 2], [0, 2], [0, 1]])[np.abs(normals).argmax(axis=1)]
    flat = np.take_along_axis(corners, axes[:, None], axis=2)
    uvs = (flat - flat.reshape(-1, 2).min(axis=0)) / shape.material.tile
    indices = np.arange(corners.size // 3).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), uvs.reshape(-1, 2), indices)


@cache
def _unit_box() -> tuple[Mesh, FloatArray]:
    """A cube of side 1 around the origin, and which sides (24 * 2, 3) its u and v run along."""
    faces = [  # origin, edge along u, edge along v, normal
        ((-1, -1, -1), (1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ((1, -1, -1), (0, 1, 0), (0, 0, 1), (1, 0, 0)),
        ((1, 1, -1), (-1, 0, 0), (0, 0, 1), (0, 1, 0)),
        ((-1, 1, -1), (0, -1, 0), (0, 0, 1), (-1, 0, 0)),
        ((-1, -1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((-1, 1, -1), (1, 0, 0), (0, -1, 0), (0, 0, -1)),
    ]
    origin, along, up, normals = (np.array(column, dtype=np.float64) for column in zip(*faces, strict=True))
    corners = np.stack([0.5 * origin, 0.5 * origin + along, 0.5 * origin + along + up, 0.5 * origin + up], axis=1)
    quads = 4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    uvs = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (6, 1))
    spans = np.repeat(np.abs(np.stack([along, up], axis=1)), 4, axis=0).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), np.repeat(normals, 4, axis=0), uvs, quads.reshape(-1, 3)), spans


@cache
def _unit_cylinder() -> Mesh:
    """Radius 1 around the z axis from 0 to 1, with both ends."""
    angle = np.linspace(0.0, 2 * np.pi, _SEGMENTS + 1)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    top = np.array([0.0, 0.0, 1.0])
    wall = Mesh(
        np.concatenate([rim, rim + top]),
        np.concatenate([rim, rim]),
        np.column_stack([np.tile(angle, 2), np.repeat([0.0, 1.0], len(angle))]),
        _grid_triangles(2, len(angle)),
    )
    fan = np.column_stack([np.zeros(_SEGMENTS, int), 1 + np.arange(_SEGMENTS), 2 + np.arange(_SEGMENTS)])
    flat = np.zeros((_SEGMENTS + 2, 2))
    ends = [
        Mesh(np.concatenate([[0 * top], rim]) + height * top, np.tile(sign * top, (len(flat), 1)), flat, triangles)
        for height, sign, triangles in ((1.0, 1.0, fan), (0.0, -1.0, fan[:, ::-1]))
    ]
    return _merged([wall, *ends])


@cache
def _unit_sphere(segments: int) -> Mesh:
    """Radius 1 around the origin."""
    rows = segments // 2 + 1
    polar, angle = np.meshgrid(np.linspace(np.pi, 0.0, rows), np.linspace(0.0, 2 * np.pi, segments + 1), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=-1)
    normals = points.reshape(-1, 3)
    uvs = np.stack([angle, np.pi - polar], axis=-1).reshape(-1, 2)
    return Mesh(normals, normals, uvs, _grid_triangles(rows, segments + 1))


@mesh.register
def _ribbon(shape: Ribbon) -> Mesh:
    middle = 0.5 * (shape.left + shape.right)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    v = along / shape.material.tile[1]
    count = len(middle)
    return Mesh(
        np.concatenate([shape.right, shape.left]),
        np.tile([0.0, 0.0, 1.0], (2 * count, 1)),
        np.concatenate([np.stack([np.full(count, 0.999), v], axis=1), np.stack([np.full(count, 0.001), v], axis=1)]),
        _grid_triangles(2, count),
    )


@mesh.register
def _ground(shape: Ground) -> Mesh:
    low, high = np.array(shape.low), np.array(shape.high)
    cells = np.ceil((high - low) / _GROUND_CELL).astype(int)
    y, x = np.meshgrid(*(low[i] + _GROUND_CELL * np.arange(cells[i] + 1) for i in (1, 0)), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    uvs = (vertices[:, :2] - low) / shape.material.tile
    return Mesh(vertices, normals, uvs, _grid_triangles(cells[1] + 1, cells[0] + 1))


def obj_text(shape: Mesh, library: str | None = None) -> str:
    """The mesh as a Wavefront OBJ file, with the material of the MTL file `library` if there is one."""
    corners = np.repeat(shape.triangles + 1, 3, axis=1)  # the same index for vertex, texture and normal
    parts = [
        ("v %.4f %.4f %.4f\n", shape.vertices),
        ("vt %.4f %.4f\n", shape.uvs),
        ("vn %.3f %.3f %.3f\n", shape.normals),
        ("f %d/%d/%d %d/%d/%d %d/%d/%d\n", corners),
    ]
    head = "" if library is None else f"mtllib {library}\nusemtl {_MATERIAL}\n"
    return head + "".join((line * len(rows)) % tuple(rows.ravel().tolist()) for line, rows in parts)


def mtl_text(picture: str) -> str:
    """A Wavefront MTL file with one material, which shows `picture` (path relative to the file)."""
    return f"newmtl {_MATERIAL}\nmap_Kd {picture}\n"


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
    lower = corner + np.array([0, 1, columns + 1])
    upper = corner + np.array([0, columns + 1, columns])
    return np.concatenate([lower, upper])


def _merged(meshes: list[Mesh]) -> Mesh:
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uvs for m in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=True)]),
    )
