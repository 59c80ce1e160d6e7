"""Charts of records and sweeps: drawn with Matplotlib's Agg, never with pyplot, saved as PNG.

The patch diagram (`diagram`) is SVG and needs no Matplotlib but for the widths of letters.
"""

from hybrid.charts.coupling import coupling_chart
from hybrid.charts.plotter import xy_plot
from hybrid.charts.strip import strip_chart
from hybrid.charts.style import save

__all__ = ["coupling_chart", "save", "strip_chart", "xy_plot"]
