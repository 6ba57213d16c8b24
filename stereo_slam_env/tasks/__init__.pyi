"""Public names of this room; each is imported when it is first used."""

from .branches import BranchChoice as BranchChoice
from .branches import explore_and_close as explore_and_close
from .branches import to_new_roads as to_new_roads
from .closed_loop import RouteByEstimate as RouteByEstimate
from .closed_loop import drive_slowly as drive_slowly
from .drive_choices import DriveChoices as DriveChoices
from .explore import Coverage as Coverage
from .explore import explore_by_sweeping as explore_by_sweeping
from .levels import LEVELS as LEVELS
from .revisit import LoopClosure as LoopClosure
from .revisit import close_if_it_pays as close_if_it_pays
