"""The catalogue of physical effects: each module is one, and says all there is to say of it."""

from importlib import import_module
from pkgutil import iter_modules

import numpy as np

from calrig.calibration.regression.column_units import TIMES, unit_of_column
from calrig.calibration.regression.effect import ApplyError, Covariate, Effect, EffectError
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

UNNAMED = "unnamed"


def _registered(module: str) -> Effect:
    """Return the effect that a module of this package binds; EffectError where it binds none of that name."""
    effect = getattr(import_module(f"{__name__}.{module}"), "EFFECT", None)
    if not isinstance(effect, Effect):
        raise EffectError(f"{__name__}.{module} lacks EFFECT, the effect that it is there to describe")
    if effect.name != module:
        raise EffectError(f"{__name__}.{module} describes {effect.name!r}: name the module after the effect")
    return effect


EFFECTS: dict[str, Effect] = {found.name: _registered(found.name) for found in iter_modules(__path__)}
"""Every effect by name, the shapes that have none among them."""
CATALOGUE: tuple[Effect, ...] = tuple(effect for name, effect in EFFECTS.items() if name != UNNAMED)
"""Every effect that calrig has physics for."""


def effect_of(name: str) -> Effect:
    """Return the effect of a name; ApplyError where this version knows none."""
    if name not in EFFECTS:
        raise ApplyError(f"the effect {name!r} is not in the catalogue of this version of calrig")
    return EFFECTS[name]


def title_inside(name: str, *, reference_is_good: bool) -> str:
    """Return an effect's title inside a sentence; the name itself of one that this version does not know."""
    if name == UNNAMED:
        return "an unknown effect"
    if name not in EFFECTS:
        return name.replace("_", " ")
    return EFFECTS[name].wording(reference_is_good=reference_is_good).inside


def covariate_of(name: str) -> Covariate:
    """The covariate of a name in documents: an effect's, else a column, with the unit that its name has."""
    known = (effect.covariate for effect in CATALOGUE if effect.covariate.name == name)
    return next(known, None) or Covariate(name, name, unit_of_column(name), lambda r: _column(r, name))


def _column(r: Responses, name: str) -> FloatArray | None:
    """Return (n,) a column of that name, or the product of those that it is made of."""
    if name in r.covariates or TIMES not in name:
        return r.covariates.get(name)
    factors = [covariate_of(factor).of(r) for factor in name.split(TIMES)]
    known = [factor for factor in factors if factor is not None]
    return np.asarray(np.prod(known, axis=0), dtype=np.float64) if len(known) == len(factors) else None
