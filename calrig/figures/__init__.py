"""Every picture, drawn once: measurements in, a figure in plotly's JSON form out.

Only plain dicts and lists come out, so nothing here needs plotly itself, and what is not known is None,
which plotly leaves out of a line. Colours keep a contrast of 3:1 or more on white and on near-black alike;
a page may set text and grid to its own theme over `layout`.
"""

from calrig.figures.diagnosis import before_and_after, error_map, partial_residual
from calrig.figures.history import Run, compare, control_chart, history
from calrig.figures.parts import PALETTE, Figure
from calrig.figures.runs import MAX_POINTS, Curve, residual, residuals_overlaid, timeline
