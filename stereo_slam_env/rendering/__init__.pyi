"""Public names of this room; each is imported when it is first used."""

from .backends import RENDERERS as RENDERERS
from .backends import make_renderer as make_renderer
from .backends import renderer_identity as renderer_identity
from .overlay import tracks_picture as tracks_picture
