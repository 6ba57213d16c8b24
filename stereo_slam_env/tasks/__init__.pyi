"""Public names of this room; each is imported when it is first used."""

from .closed_loop import RouteByEstimate as RouteByEstimate
from .closed_loop import drive_slowly as drive_slowly
from .explore import Coverage as Coverage
from .explore import explore_by_sweeping as explore_by_sweeping
from .levels import LEVELS as LEVELS
from .levels import Curriculum as Curriculum
from .revisit import LoopClosure as LoopClosure
from .revisit import close_if_it_pays as close_if_it_pays
