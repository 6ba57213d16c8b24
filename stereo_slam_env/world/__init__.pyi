"""Public names of this room; each is imported when it is first used."""

from .meshes import obj_mesh as obj_mesh
from .meshes import urdf_solids as urdf_solids
from .props import Layout as Layout
from .props import facing_points as facing_points
from .road import ASPHALT_HEIGHT as ASPHALT_HEIGHT
from .road import RoadNetwork as RoadNetwork
from .road import Strip as Strip
from .road import paved as paved
from .road import road_along as road_along
from .routes import Route as Route
from .routes import available_routes as available_routes
from .routes import named_route as named_route
from .scene import Box as Box
from .scene import Cylinder as Cylinder
from .scene import Ground as Ground
from .scene import Material as Material
from .scene import Scene as Scene
from .scene import Sphere as Sphere
from .scene import TriangleMesh as TriangleMesh
from .surroundings import available_scenes as available_scenes
from .surroundings import build_scene as build_scene
