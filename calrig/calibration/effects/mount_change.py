"""Another angle of the unit on the stage than in the run before: reading and accelerometer turned alike."""

import numpy as np

from calrig.calibration.regression.effect import Effect, NotInFlight, Parameter, Shape
from calrig.calibration.regression.run_changes import RUN
from calrig.calibration.regression.terms import tilted

EFFECT = Effect(
    name="mount_change",
    title="Unit at another angle to the stage",
    origin="mounting",
    scope="run",
    covariate=RUN,
    parameters=(Parameter("deg", "Angle (later − earlier)", "°"),),
    formula="deg in the later runs",
    forms=lambda r, _at: iter([Shape(tilted(np.ones(len(r))), ("deg",))]),
    on_reading_deg=lambda p: np.full(len(p.theta_deg), p.value("deg")),
    in_c=NotInFlight("it is the angle at which the unit was clamped to a stage"),
    seen_by_gravity="the accelerometer turned as the reading did",
    apart="remounted, homed again or a package that turned look the same: remount the unit and home the "
    "stage several times to know how well either repeats",
    remedy="calibrate with the clamping repeated; fly the bias of the mount that flies",
)
