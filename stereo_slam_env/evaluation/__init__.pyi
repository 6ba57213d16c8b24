"""Public names of this room; each is imported when it is first used."""

from .bands import mean_band as mean_band
from .bands import share_inside as share_inside
from .bands import studentised_interval as studentised_interval
from .figures import readable as readable
from .filter_run import run_filter as run_filter
from .map_scoring import LandmarkTrace as LandmarkTrace
from .results import FilterRun as FilterRun
from .results import FilterSummary as FilterSummary
from .run_figures import figures_of as figures_of
from .run_figures import summarise as summarise
from .run_figures import summarise_all as summarise_all
from .trajectory_metrics import ate_rigid as ate_rigid
from .trajectory_metrics import ate_unaligned as ate_unaligned
from .trajectory_metrics import end_drift_percent as end_drift_percent
from .trajectory_metrics import path_length as path_length
from .trajectory_metrics import root_mean_square as root_mean_square
from .trajectory_runs import score_runs as score_runs
