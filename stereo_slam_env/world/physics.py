"""Physics engine: rays, collisions and pictures of a scene. The only file that imports pybullet."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import threading
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.contract.extras import require_core
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.world.meshes import Mesh, body_meshes, mesh, mtl_text, obj_text, scene_meshes
from stereo_slam_env.world.scene import (
    Box,
    Cylinder,
    Look,
    Material,
    MovingBody,
    Primitive,
    Scene,
    Sphere,
    TriangleMesh,
)
from stereo_slam_env.world.street_textures import texture


@contextmanager
def _without_banner() -> Iterator[None]:
    """Silence the native standard error: PyBullet prints its build time to it on import."""
    saved_stdout = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved_stdout, 2)
        os.close(saved_stdout)
        os.close(nowhere)


require_core("pybullet")
with _without_banner():
    import pybullet

_BODY_REACH, _SHAPES_PER_BODY = 24.0, 16
"""Consecutive solids within so many m of the first of them share a body, up to so many: PyBullet allows no more.

Building and rays are both faster than with one body each; with larger bodies rays would test shapes far away.
"""
_EGO_GROUP = 64
_NOT_EGO = 0xFFFF & ~_EGO_GROUP
_SURFACE_GAP = 0.05
"""A ray to a point on a surface stops this short of it, m, so that the surface itself does not hide it."""


class PhysicsWorld:
    """A scene in PyBullet, without a window. Everything is in the scene frame S.

    The engine is started by the first `build`, so an unused world costs nothing. `close` may be called at any time,
    also twice; `build` starts again.
    """

    def __init__(self) -> None:
        self._client: int | None = None
        self._ground = self._ego = self._speck = -1
        self._time = 0.0
        self._drawn = False
        self._moving: list[tuple[MovingBody, list[int]]] = []
        self._stop: weakref.finalize[[int], PhysicsWorld] | None = None

    def build(self, scene: Scene, ego_size: tuple[float, float, float]) -> None:
        """Replace what is there by the solids of `scene` at time 0 and a car's body: length, width, height, m."""
        if self._client is None:
            self._client = pybullet.connect(pybullet.DIRECT)
            self._stop = weakref.finalize(self, pybullet.disconnect, self._client)
        pybullet.resetSimulation(physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._client)
        self._drawn = False
        # Below everything: a body without a visual would be drawn by TinyRenderer as its collision shape.
        self._speck = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=[0.001] * 3, visualFramePosition=[0, 0, -500], physicsClientId=self._client
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        self._ground = self._body(plane)
        self._bodies(scene.solids)
        self._moving = [(body, self._bodies(p for p in body.parts if p.solid)) for body in scene.moving]
        half = [0.5 * side for side in ego_size]
        ego = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=self._client)
        self._ego = self._body(ego, mass=1.0)
        pybullet.setCollisionFilterGroupMask(self._ego, -1, _EGO_GROUP, _NOT_EGO, physicsClientId=self._client)
        self.set_time(0.0)

    def dress(self, scene: Scene) -> None:
        """Add what `camera_image` draws to the built `scene`; without pictures that can be spared."""
        with _exchange_folder() as folder:
            self._draw(scene_meshes(scene), folder)
            for body, parts in self._moving:
                parts += self._draw(body_meshes(body), folder)
        self.set_time(self._time)
        self._drawn = True

    def set_time(self, time: float) -> None:
        """Move what moves to where it is at `time`, s."""
        self._time = time
        for body, parts in self._moving:
            position, yaw = body.pose_at(time)
            place, turn = position.tolist(), [0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]
            for part in parts:
                pybullet.resetBasePositionAndOrientation(part, place, turn, physicsClientId=self._connected)

    def visible(self, cameras: FloatArray, points: FloatArray) -> BoolArray:
        """Mask of points (N, 3) on surfaces that are seen from all `cameras` (C, 3), m; the ego car hides nothing."""
        rays = points - cameras[:, None]
        lengths = np.sqrt(np.einsum("eni,eni->en", rays, rays))
        ends = points - rays * (_SURFACE_GAP / lengths)[..., None]
        visible_points = list(range(len(points)))
        for start, targets in zip(cameras.tolist(), ends.tolist(), strict=True):
            if not visible_points:
                break
            # A ray that hits is the dearest: none from the second camera to what the first does not see.
            hits = pybullet.rayTestBatch(
                [start] * len(visible_points),
                [targets[i] for i in visible_points],
                numThreads=1,
                collisionFilterMask=_NOT_EGO,
                physicsClientId=self._connected,
            )
            visible_points = [i for i, hit in zip(visible_points, hits, strict=True) if hit[0] < 0]
        visible = np.zeros(len(points), dtype=bool)
        visible[visible_points] = True
        return visible

    def ego_collides(self, position: FloatArray, R_sb: FloatArray) -> bool:
        """Put the car's body (its x axis forward) at a pose and tell whether it touches a solid.

        The ground is none: a car that bounces on its springs touches nothing.
        """
        client = self._connected
        pybullet.resetBasePositionAndOrientation(
            self._ego, position.tolist(), rotations.from_matrix(R_sb).tolist(), physicsClientId=client
        )
        low, high = pybullet.getAABB(self._ego, physicsClientId=client)
        near = pybullet.getOverlappingObjects(low, high, physicsClientId=client) or ()
        if all(body in (self._ego, self._ground) for body, _ in near):
            return False  # not even the boxes around bodies touch: usual, and told at a tenth of the cost
        pybullet.performCollisionDetection(physicsClientId=client)
        contacts = pybullet.getContactPoints(bodyA=self._ego, physicsClientId=client) or ()
        return any(contact[2] != self._ground and contact[8] <= 0.0 for contact in contacts)

    def camera_image(
        self,
        view: FloatArray,
        projection: FloatArray,
        width: int,
        height: int,
        light: Sequence[float],
        ambient: float = Look.ambient,
        diffuse: float = Look.diffuse,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw with TinyRenderer.

        Takes row-major OpenGL matrices (4, 4), the size in px, the direction towards the sun (3,) and the shares of
        the light (see `Look`); returns RGB (H, W, 3) and the depth buffer (H, W) in 0..1, whose far end is nothing.
        """
        if not self._drawn:
            raise RuntimeError("the scene was built without pictures: call dress first")
        _, _, rgba, depth, _ = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=view.flatten(order="F").tolist(),
            projectionMatrix=projection.flatten(order="F").tolist(),
            lightDirection=list(light),
            lightColor=[1.0, 1.0, 1.0],
            lightAmbientCoeff=ambient,
            lightDiffuseCoeff=diffuse,
            lightSpecularCoeff=0.0,
            shadow=0,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._connected,
        )
        # A PyBullet built without NumPy returns tuples, of which `bytes` makes an image in a third of NumPy's time.
        pixels = np.frombuffer(bytes(rgba), dtype=np.uint8).reshape(height, width, 4)
        rgb = cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB)
        return np.asarray(rgb, dtype=np.uint8), np.reshape(np.asarray(depth, dtype=np.float32), (height, width))

    def close(self) -> None:
        """Stop the engine."""
        if self._stop is not None:
            self._stop()
        self._client = self._stop = None

    @property
    def _connected(self) -> int:
        if self._client is None:
            raise RuntimeError("the world is not built: reset the environment first")
        return self._client

    def _bodies(self, solids: Iterable[Primitive]) -> list[int]:
        """Collision bodies of some solids, all with their origin where that of the solids is."""
        meshes, shapes = [], []
        for solid in solids:
            if isinstance(solid, TriangleMesh):
                meshes.append(mesh(solid))
            else:
                shapes.append(_collision_shape(solid))
        bodies = self._mesh_bodies(meshes) if meshes else []
        for group in _neighbours(shapes):
            columns = {key: [shape[key] for shape in group] for key in group[0]}
            bodies.append(self._body(pybullet.createCollisionShapeArray(**columns, physicsClientId=self._connected)))
        return bodies

    def _mesh_bodies(self, meshes: Iterable[Mesh]) -> list[int]:
        """Collision bodies of surfaces, hollow ones too, each through a file, see `_draw`."""
        bodies = []
        with _exchange_folder() as folder:
            file = folder / "solid.obj"
            for each in meshes:
                file.write_text(obj_text(each), encoding="ascii")
                shape = pybullet.createCollisionShape(
                    pybullet.GEOM_MESH,
                    fileName=str(file),
                    flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                    physicsClientId=self._connected,
                )
                bodies.append(self._body(shape))
        return bodies

    def _body(self, shape: int, mass: float = 0.0) -> int:
        """A collision body that is not drawn."""
        return int(pybullet.createMultiBody(mass, shape, self._speck, physicsClientId=self._connected))

    def _draw(self, meshes: Mapping[Material, Mesh], folder: Path) -> list[int]:
        """Visual bodies of some meshes, one for each material."""
        client = self._connected
        file = folder / f"{client}.obj"
        bodies = []
        for material, drawn in meshes.items():
            # Through a file: PyBullet leaks vertices that are passed as Python objects.
            file.write_text(obj_text(drawn, _library(folder, material)), encoding="ascii")
            visual = pybullet.createVisualShape(
                pybullet.GEOM_MESH, fileName=str(file), rgbaColor=[*material.color, 1.0], physicsClientId=client
            )
            # With caching a picture is decoded once; ending it forgets the mesh, since the next has the same name.
            pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=client)
            bodies.append(int(pybullet.createMultiBody(0, -1, visual, physicsClientId=client)))
            pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
        return bodies


@contextmanager
def _exchange_folder() -> Iterator[Path]:
    """A folder for PyBullet to read meshes and pictures from; it is gone afterwards.

    It has the same path every time in one process, since PyBullet keeps each picture under its path for ever.
    """
    folder, one_at_a_time = _exchange_place(os.getpid())
    with one_at_a_time:
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            shutil.rmtree(folder)


@cache
def _exchange_place(process: int) -> tuple[Path, threading.Lock]:
    """An unused path for one process, and the lock for using it."""
    with tempfile.TemporaryDirectory(prefix=f"stereo-slam-{process}-") as unused:
        return Path(unused), threading.Lock()


def _library(folder: Path, material: Material) -> str | None:
    """Name of the material library that shows the texture of `material`."""
    if material.texture is None:
        return None
    name = f"{material.texture}-{material.variant}"
    library = folder / f"{name}.mtl"
    if not library.exists():
        (folder / f"{name}.png").write_bytes(_png(material.texture, material.variant))
        library.write_text(mtl_text(f"{name}.png"), encoding="ascii")
    return library.name


@cache
def _png(name: str, variant: int) -> bytes:
    _, encoded = cv2.imencode(".png", cv2.cvtColor(texture(name, variant), cv2.COLOR_RGB2BGR))
    return bytes(encoded)


def _neighbours(shapes: Iterable[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Groups of consecutive collision shapes that stand together."""
    groups: list[list[dict[str, Any]]] = []
    for shape in shapes:
        here = shape["collisionFramePositions"][:2]
        near = groups and math.dist(here, groups[-1][0]["collisionFramePositions"][:2]) < _BODY_REACH
        if near and len(groups[-1]) < _SHAPES_PER_BODY:
            groups[-1].append(shape)
        else:
            groups.append([shape])
    return groups


def _collision_shape(shape: Box | Cylinder | Sphere) -> dict[str, Any]:
    """Arguments of `createCollisionShapeArray` for one shape."""
    kind, half_extents, radius, length, turn = pybullet.GEOM_SPHERE, [1.0, 1.0, 1.0], 1.0, 1.0, [0.0, 0.0, 0.0, 1.0]
    if isinstance(shape, Box):
        kind, half_extents, middle = pybullet.GEOM_BOX, [0.5 * s for s in shape.size], list(shape.center)
        turn = [0.0, 0.0, math.sin(0.5 * shape.yaw), math.cos(0.5 * shape.yaw)]
    elif isinstance(shape, Cylinder):
        start, end = np.array(shape.start), np.array(shape.end)
        length = float(np.linalg.norm(end - start))
        kind, radius, middle = pybullet.GEOM_CYLINDER, shape.radius, (0.5 * (start + end)).tolist()
        turn = _turn_from_z((end - start) / length)
    else:
        radius, middle = shape.radius, list(shape.center)
    return {
        "shapeTypes": kind,
        "halfExtents": half_extents,
        "radii": radius,
        "lengths": length,
        "collisionFramePositions": middle,
        "collisionFrameOrientations": turn,
    }


def _turn_from_z(axis: FloatArray) -> list[float]:
    """A quaternion xyzw that turns z into the unit vector `axis` or, the same for a cylinder, into -axis."""
    x, y, z = axis if axis[2] >= 0 else -axis
    quaternion = np.array([-y, x, 0.0, 1.0 + z])
    turned: list[float] = (quaternion / np.linalg.norm(quaternion)).tolist()
    return turned
