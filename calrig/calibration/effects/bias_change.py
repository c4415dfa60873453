"""Another bias of the reading than in the run before, of which the accelerometer knows nothing."""

import numpy as np

from calrig.calibration.regression.channels import READING
from calrig.calibration.regression.effect import Effect, NotInFlight, Parameter, Shape
from calrig.calibration.regression.run_changes import RUN

EFFECT = Effect(
    name="bias_change",
    title="Another bias of the reading",
    origin="process",
    scope="run",
    covariate=RUN,
    parameters=(Parameter("deg", "Bias (later − earlier)", "°"),),
    formula="deg in the later runs",
    forms=lambda r, _at: iter([Shape({READING: np.ones(len(r))}, ("deg",))]),
    on_reading_deg=lambda p: np.full(len(p.theta_deg), p.value("deg")),
    in_c=NotInFlight("the bias that is fitted holds it"),
    apart="the filter, its offsets or its gyro bias moved, and not the unit",
    seen_by_gravity="the reading moved and the accelerometer did not",
    remedy="look at what filters the reading: its offsets, its level at start-up, the bias of its gyro",
)
