"""Compare runs of a unit over time: changes, repeatability, control charts, due dates."""

from calrig.calibration.histories.between_runs import (
    FALSE_DISCOVERY_RATE,
    Changes,
    Components,
    Differences,
    changes,
    components,
    drift_deg_per_day,
)
from calrig.calibration.histories.charts import (
    UNIT_CHART,
    Bounds,
    Checks,
    ControlChart,
    Forecast,
    checks,
    control_chart,
    forecast,
)
from calrig.calibration.histories.repeatability import IntArray, Repeatability, Runs, pairs
