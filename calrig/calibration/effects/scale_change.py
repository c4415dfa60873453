"""Another scale of the angle than in the run before: another stage, or another ratio of its gear."""

from calrig.calibration.regression.effect import Effect, NotInFlight, Parameter, Shape, Wording
from calrig.calibration.regression.run_changes import RUN
from calrig.calibration.regression.terms import turned, turns

EFFECT = Effect(
    name="scale_change",
    title="Another scale of the stage",
    origin="stage",
    scope="run",
    covariate=RUN,
    parameters=(Parameter("scale", "Scale (later − earlier)", ""),),
    formula="scale·θ in the later runs",
    forms=lambda r, _at: iter([Shape(turned(r, r.theta_deg), ("scale",))] if turns(r) else []),
    on_reading_deg=lambda p: p.value("scale") * p.theta_deg,
    in_c=NotInFlight("an elevation by atan2 has no scale of its own: it belongs to the stage"),
    apart="the unit measured on another stage does not have it",
    seen_by_gravity="the gyro measures it and |accelerometer| does not, but changes with an offset along z",
    remedy="compare the stages, or the steps per degree that they are set to",
    as_sensor=Wording("Another scale of the reading", "compare the settings of sensor and reference"),
)
