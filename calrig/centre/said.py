"""What a bench says of itself beside its rigs: believed as far as it has the right form, else not known."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Annotated, Any, TypeVar

from pydantic import AwareDatetime, BaseModel, Field, ValidationError

from calrig.store.benches import Bench

Count = Annotated[int, Field(ge=0, le=2**53)]
Said = TypeVar("Said", bound=BaseModel)


class SaidOutbox(BaseModel):
    """What it has not delivered yet, and since when the oldest of it waits."""

    parcels: Count
    oldest_at: AwareDatetime | None


class _LeaseLosses(BaseModel):
    lease_losses: Count


def said_outbox(bench: Bench) -> SaidOutbox | None:
    """What a bench has yet to deliver; None where it does not say."""
    return _read(SaidOutbox, bench.said.get("outbox"))


def said_lease_losses(bench: Bench) -> int | None:
    """How often a bench's lease ran out since its agent began; None where it does not say."""
    said = _read(_LeaseLosses, bench.said)
    return None if said is None else said.lease_losses


def _read(model: type[Said], said: Any) -> Said | None:
    try:
        return model.model_validate(said)
    except ValidationError:
        return None
