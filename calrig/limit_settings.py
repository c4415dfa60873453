"""Limits that units are held against, of the configuration or kept by people in the store."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from calrig.laboratory import Strict

Positive = Annotated[float, Field(gt=0)]
Range = tuple[float, float]


class LimitSettings(Strict):
    """What units are held against, a `[[limit]]` or an entry of `/api/limits`; null asks nothing of that."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    units: Annotated[str, Field(min_length=1, max_length=200)] = "*"
    rig: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    max_error_deg: Positive | None = None
    bias_deg: Range | None = None
    scale: Range | None = None
    rms_deg: Positive | None = None
    expanded_uncertainty_deg: Positive | None = None
    rule: Literal["simple", "guarded"] = "simple"
    guard: Annotated[float, Field(gt=0, le=10)] = 1.0

    @field_validator("bias_deg", "scale")
    @classmethod
    def _is_ordered(cls, ends: Range | None) -> Range | None:
        if ends is not None and ends[0] >= ends[1]:
            raise ValueError(f"the lower end {ends[0]:g} is not below the upper one {ends[1]:g}")
        return ends

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        asked = (self.max_error_deg, self.bias_deg, self.scale, self.rms_deg, self.expanded_uncertainty_deg)
        if all(one is None for one in asked):
            raise ValueError(f"the limit {self.name!r} asks nothing: give it at least one figure")
        return self
