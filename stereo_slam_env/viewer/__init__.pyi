"""Public names of this room; each is imported when it is first used."""

from .drive_picture import save_film as save_film
from .drive_picture import save_still as save_still
from .drive_picture import style_context as style_context
from .rerun_view import RerunView as RerunView
from .search_view import search_film as search_film
from .search_view import search_picture as search_picture
from .watched_drive import Drive as Drive
from .watched_drive import Recorder as Recorder
from .watched_drive import revisit as revisit
