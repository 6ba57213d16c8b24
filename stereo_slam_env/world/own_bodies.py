"""Bodies of a user's own: the solids of a URDF file, and triangle meshes of OBJ files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.validation import finite_array, first_line, positive
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.files.readers import read_text
from stereo_slam_env.world.scene import Box, Cylinder, Material, Primitive, Sphere, TriangleMesh

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
    """Where each link is."""
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
    given = {} if origin is None else origin.attrib
    angles, place = (_numbers(given.get(name, "0 0 0"), 3) for name in ("rpy", "xyz"))
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
