"""Triangle meshes of a scene for renderers, one for each material, and bodies of a user's own (URDF, OBJ)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, singledispatch
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from filters.contract.validation import finite_array, first_line, positive
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.files.readers import read_text
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


MOST_TEXT = 5_000_000
"""bytes of a URDF file."""
MOST_LINKS = 2_000
_UPRIGHT = 1e-9
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of a box, and its sides, counter-clockwise from outside."""
Placing = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and place (3,), m."""


def urdf_solids(
    path: str | Path, material: Material, position: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0
) -> tuple[Primitive, ...]:
    """The collision shapes of a URDF file as solids of a scene, its joints where they are at 0.

    Parameters
    ----------
    path : str or Path
        The file. Meshes are OBJ files in its folder, their names relative to it.
    material : Material
        Look of all of them.
    position : (3,) tuple
        Where its root is in S, m.
    yaw : float
        By how much it is turned about z, rad.

    Raises
    ------
    ValueError
        The file cannot be read, is no URDF, or has a shape that is no box, cylinder, sphere or OBJ mesh.
    """
    file = Path(path)
    try:
        text = read_text(file, most_bytes=MOST_TEXT)
    except FileNotFoundError:
        raise ValueError(f"there is no file {file}") from None
    if "<!" in text.replace("<!--", ""):  # entities of entities say in a line what fills the memory
        raise ValueError(f"{file} has declarations (<!DOCTYPE ...>), which are not read: remove them")
    try:
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{file} is no URDF: {first_line(error)}") from None
    at = Rotation.from_euler("z", yaw).as_matrix(), finite_array("position", position, (3,))
    try:
        links = _placed_links(robot, at)
        return tuple(
            _solid(file, geometry, _along(links[link.attrib["name"]], _origin(collision)), material)
            for link in robot.iter("link")
            for collision in link.iter("collision")
            for geometry in collision.iterfind("geometry/*")
        )
    except (KeyError, AttributeError) as error:
        raise ValueError(f"{file} is no URDF: it lacks {error}") from None


def obj_mesh(
    path: str | Path,
    material: Material,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    scale: float = 1.0,
) -> TriangleMesh:
    """The triangles of a Wavefront OBJ file; arguments as of `urdf_solids`, `scale` in m per unit of the file.

    Raises
    ------
    ValueError
        The file cannot be read, or has no triangles.
    """
    vertices, triangles = _read_obj(Path(path), None)
    R = Rotation.from_euler("z", yaw).as_matrix()
    placed = positive("scale", scale) * vertices @ R.T + finite_array("position", position, (3,))
    return TriangleMesh(placed, triangles, material)


def _placed_links(robot: Element, root: Placing) -> dict[str, Placing]:
    """Pose of each link."""
    if len(robot.findall("link")) > MOST_LINKS:
        raise ValueError(f"a robot of more than {MOST_LINKS} links is refused")
    joints = {joint.find("child").attrib["link"]: joint for joint in robot.iterfind("joint")}  # type: ignore[union-attr]
    placed = {link.attrib["name"]: root for link in robot.iterfind("link") if link.attrib["name"] not in joints}
    waiting = dict(joints)
    while waiting:
        ready = [child for child, joint in waiting.items() if _parent(joint) in placed]
        if not ready:
            raise KeyError(f"a parent of link {next(iter(waiting))!r}")
        for child in ready:
            joint = waiting.pop(child)
            placed[child] = _along(placed[_parent(joint)], _origin(joint))
    return placed


def _parent(joint: Element) -> str:
    return joint.find("parent").attrib["link"]  # type: ignore[union-attr]


def _origin(element: Element) -> Placing:
    origin = element.find("origin")
    attributes = {} if origin is None else origin.attrib
    angles, place = (_numbers(attributes.get(name, "0 0 0"), 3) for name in ("rpy", "xyz"))
    return Rotation.from_euler("xyz", angles).as_matrix(), place


def _along(outer: Placing, inner: Placing) -> Placing:
    return outer[0] @ inner[0], outer[0] @ inner[1] + outer[1]


def _numbers(text: str, count: int) -> FloatArray:
    try:
        return finite_array("numbers", [float(word) for word in text.split()], (count,))
    except ValueError:
        raise KeyError(f"{count} numbers in {text!r}") from None


def _solid(file: Path, geometry: Element, at: Placing, material: Material) -> Primitive:
    R, place = at
    x, y, z = place.tolist()
    if geometry.tag == "sphere":
        return Sphere((x, y, z), float(_numbers(geometry.attrib["radius"], 1)[0]), material)
    if geometry.tag == "cylinder":
        half = 0.5 * float(_numbers(geometry.attrib["length"], 1)[0]) * R[:, 2]
        (a, b, c), (d, e, f) = (place - half).tolist(), (place + half).tolist()
        return Cylinder((a, b, c), (d, e, f), float(_numbers(geometry.attrib["radius"], 1)[0]), material)
    if geometry.tag == "box":
        size = _numbers(geometry.attrib["size"], 3)
        if R[2, 2] > 1.0 - _UPRIGHT:
            length, width, height = size.tolist()
            return Box((x, y, z), (length, width, height), float(np.arctan2(R[1, 0], R[0, 0])), material)
        sides = np.array([[side[:3], (side[0], side[2], side[3])] for side in _SIDES]).reshape(-1, 3)
        return TriangleMesh((_CORNERS * size) @ R.T + place, sides, material)
    if geometry.tag == "mesh":
        vertices, triangles = _read_obj(file.parent / geometry.attrib["filename"], file.parent)
        scale = _numbers(geometry.attrib.get("scale", "1 1 1"), 3)
        return TriangleMesh((vertices * scale) @ R.T + place, triangles, material)
    raise ValueError(f"{file} has a {geometry.tag}: shapes must be box, cylinder, sphere or mesh")


def _read_obj(path: Path, inside: Path | None) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of an OBJ file; polygons are split."""
    if path.suffix.lower() != ".obj":
        raise ValueError(f"{path} must be an OBJ file: convert it")
    try:
        lines = [line.split() for line in read_text(path, inside=inside).splitlines()]
    except FileNotFoundError:
        raise ValueError(f"there is no file {path}") from None
    try:
        vertices = np.array([[float(word) for word in line[1:4]] for line in lines if line[:1] == ["v"]])
        faces = [[int(word.split("/")[0]) for word in line[1:]] for line in lines if line[:1] == ["f"]]
        indices = np.array(list(_fans(faces, len(vertices)))).reshape(-1, 3)
        if not len(indices) or vertices.ndim != 2 or not np.isfinite(vertices).all():
            raise ValueError
        if indices.min() < 0 or indices.max() >= len(vertices):
            raise ValueError
    except (ValueError, OverflowError):
        raise ValueError(f"{path} is no OBJ file with vertices and faces between them") from None
    return vertices, indices


def _fans(faces: list[list[int]], count: int) -> Iterator[tuple[int, int, int]]:
    """Triangles of polygons; indices count from 1, negative ones from the end."""
    for face in faces:
        first, *rest = (k - 1 if k > 0 else count + k for k in face)
        for second, third in pairwise(rest):
            yield first, second, third
