"""The catalogue of physical effects: each module is one, and says all there is to say of it."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from calrig.calibration.effect import ApplyError, Covariate, Effect, EffectError

UNNAMED = "unnamed"


def _registered(module: str) -> Effect:
    """The effect that a module of this package binds; EffectError where it binds none of that name."""
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
    """The effect of a name; ApplyError where this version knows none."""
    if name not in EFFECTS:
        raise ApplyError(f"the effect {name!r} is not in the catalogue of this version of calrig")
    return EFFECTS[name]


def covariate_of(name: str) -> Covariate | None:
    """The covariate of a name in documents; None for a column that no effect of the catalogue follows."""
    return next((effect.covariate for effect in CATALOGUE if effect.covariate.name == name), None)
