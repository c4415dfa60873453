"""The regression that effects and diagnosis share: channels, responses, noise model, terms of an effect."""

from calrig.calibration.regression.effect import (
    ORIGINS,
    TEMPERATURE,
    ApplyError,
    Circumstances,
    Effect,
    NotInFlight,
    Origin,
    Parameters,
    Scope,
    VectorInC,
)
from calrig.calibration.regression.request import (
    ASSUMED,
    LONGEST_PERIOD_DEG,
    MOST_PERIODS,
    AssumedReference,
    DiagnosisRequest,
)
from calrig.calibration.regression.terms import MG, c_literal
