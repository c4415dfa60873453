"""The catalogue of effects, so that whoever shows one needs no table of names, titles or units."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from fastapi import APIRouter

from calrig.api.models import Answer
from calrig.calibration.effects import EFFECTS
from calrig.calibration.regression import ORIGINS, Effect, Origin, Scope

router = APIRouter(tags=["diagnoses"])


class EffectParameter(Answer):
    """A parameter; `unit` is null where it is the covariate's own, `flag` where it is 1 or absent."""

    name: str
    title: str
    unit: str | None
    flag: bool


class CatalogueEffect(Answer):
    """An effect of the catalogue: CONTRACT section 5, in words."""

    name: str
    title: str
    origin: Origin
    origin_title: str
    scope: Scope
    covariate: str
    covariate_title: str
    covariate_unit: str
    parameters: list[EffectParameter]
    formula: str
    apart: str
    remedy: str


@router.get("/api/effects", response_model=list[CatalogueEffect], summary="The catalogue of effects")
def list_effects() -> list[CatalogueEffect]:
    """Every effect that a diagnosis may name, by name, and `unnamed`, the shapes that have none.

    `formula` is what is added to the reading; an effect of scope `unit` is applied in flight, one of scope
    `rig` belongs to the rig error map, one of scope `run` corrects nothing later.
    """
    return [_answer(effect) for effect in EFFECTS.values()]


def _answer(effect: Effect) -> CatalogueEffect:
    return CatalogueEffect(
        name=effect.name,
        title=effect.title,
        origin=effect.origin,
        origin_title=ORIGINS[effect.origin],
        scope=effect.scope,
        covariate=effect.covariate.name,
        covariate_title=effect.covariate.title,
        covariate_unit=effect.covariate.unit,
        parameters=[EffectParameter.model_validate(parameter) for parameter in effect.parameters],
        formula=effect.formula,
        apart=effect.apart,
        remedy=effect.remedy,
    )
