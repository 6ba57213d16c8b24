"""Public names of this room; each is imported when it is first used."""

from .overlay import tracks_picture as tracks_picture
from .renderers import RENDERERS as RENDERERS
from .renderers import make_renderer as make_renderer
from .renderers import renderer_identity as renderer_identity
