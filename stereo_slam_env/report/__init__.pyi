"""Public names of this room; each is imported when it is first used."""

from .charts.axes import BAND as BAND
from .charts.axes import INK as INK
from .charts.axes import MUTED as MUTED
from .charts.axes import WIDTH as WIDTH
from .charts.axes import Axis as Axis
from .charts.axes import filter_colours as filter_colours
from .charts.axes import label_room as label_room
from .charts.axes import log_axis as log_axis
from .charts.axes import panel_width as panel_width
from .charts.drawing import DASHED as DASHED
from .charts.drawing import BoxMark as BoxMark
from .charts.drawing import Chart as Chart
from .charts.drawing import Curve as Curve
from .charts.drawing import Panel as Panel
from .charts.drawing import figure as figure
from .charts.nees import plot_error_bounds as plot_error_bounds
from .charts.nees import plot_nees as plot_nees
from .page import figure_block as figure_block
from .page import html_page as html_page
from .page import on_page as on_page
from .table import Column as Column
from .table import Table as Table
from .table import TableCell as TableCell
from .table import Tone as Tone
from .table import number as number
from .trajectory_report import write_trajectory_report as write_trajectory_report
