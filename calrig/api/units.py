"""Units: their runs, changes and comparison, the calibration item as received, and their archive.

A serial number may contain `/`.
"""

import asyncio
import re
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import aclosing
from datetime import date
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Annotated, ClassVar, Literal, TypeVar
from unicodedata import category

from fastapi import APIRouter, Header, HTTPException, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response, StreamingResponse
from pydantic import Field, field_validator

from calrig.analysis.certificates import write_archive
from calrig.analysis.check_standard import with_doubts
from calrig.analysis.comparison import comparison_json
from calrig.analysis.histories import histories, unit_changes
from calrig.analysis.unit_list import (
    ListedUnit,
    UnitChange,
    UnitDue,
    UnitFilter,
    UnitVerdict,
    listed_units,
    units_csv,
)
from calrig.api.access import Who
from calrig.api.context import ApiContext, Context, KnownUnit
from calrig.api.errors import no_room
from calrig.api.jobs import BackgroundWork, Heavy
from calrig.api.measurements import prefers_csv
from calrig.api.models import Body, RunAnswer
from calrig.api.routes import BYTES, TEXT, answers
from calrig.model.comparison import Change, Comparison
from calrig.store import Store
from calrig.store.store import with_store
from calrig.store.units import CalibrationItem, ItemField

EVERY_RUN = 2**31

router = APIRouter(tags=["units"])
T = TypeVar("T")


@router.get("/api/units/{serial:path}/changes", **answers(list[Change], "What changed from run to run", 404))
def show_changes(serial: str, context: Context) -> object:
    """From each valid calibration to the next, the oldest first.

    `effects` are those of the stored diagnosis of both runs together; where there is none,
    `POST /api/runs/{to}/diagnosis` with `{"runs": [from]}` makes one.
    """
    return unit_changes(context.store, serial)


Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]


@router.get("/api/compare", **answers(Comparison, "Units side by side", 404, 429, 503))
def compare(context: Context, heavy: Heavy, unit: Units = None) -> Response:
    """Valid calibrations only; `spread` compares the differences between units with the repeatability.

    Units that changed by more than repeatability come first, in the order of significance. The test uses all
    units of the store, whichever are requested, and of very many runs the latest.
    """
    made = of_units(context, heavy, unit, partial(comparison_json, unit, context.interval_days))
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(made, media_type="application/json")


FEW_UNITS = 50
"""They are compared within 0.1 s; more are in another process, so that a stop need not wait for them."""


def of_units(
    context: ApiContext, heavy: BackgroundWork, serials: Sequence[str] | None, work: Callable[[Store], T]
) -> T:
    """Return what the work gives for the store: here for a few units, in another process for many."""
    n = context.store.units.count() if serials is None else len(serials)
    if n <= FEW_UNITS:
        return work(context.store)
    return heavy.from_thread(partial(with_store, context.store.url, work))


TURNS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows them."""
Words = Annotated[str, Field(min_length=1, max_length=500)]


class ItemBody(Body):
    """A calibration item as received; fields that are left out are not stated on its certificates.

    `supplied` names the fields that are the customer's own word; `interval_agreed_months` is for where the
    customer agreed to an interval.
    """

    TITLES: ClassVar = {
        "customer": "Customer",
        "address": "Customer's address",
        "order": "Order",
        "received_at": "Date of receipt",
        "condition": "Condition at receipt",
        "description": "Description",
        "interval_agreed_months": "Months until the next calibration",
    }

    customer: Words | None = None
    address: Words | None = None
    order: Words | None = None
    received_at: date | None = None
    condition: Words | None = None
    description: Words | None = None
    interval_agreed_months: Annotated[int, Field(ge=1, le=600)] | None = None
    supplied: Annotated[tuple[ItemField, ...], Field(max_length=7)] = ()

    @field_validator("customer", "address", "order", "condition", "description")
    @classmethod
    def _can_be_printed(cls, value: str | None) -> str | None:
        for character in (value or "").replace("\n", ""):
            if category(character) == "Cc" or character in TURNS:
                raise ValueError(f"has a character in it that cannot be printed: {character!r}")
        return value


@router.get(
    "/api/units/{serial:path}/item", **answers(CalibrationItem, "The calibration item as received", 404)
)
def show_item(unit: KnownUnit, context: Context) -> object:
    """What certificates of calibrations made from now on state of it."""
    return context.store.items.of(unit.serial) or CalibrationItem()


@router.put(
    "/api/units/{serial:path}/item",
    **answers(CalibrationItem, "Set the calibration item as received", 404, 413, 422, role="operator"),
)
def put_item(unit: KnownUnit, body: ItemBody, context: Context, who: Who) -> object:
    """All of it at once. Certificates of runs before `received_at` keep what was said before."""
    said = CalibrationItem(
        **body.model_dump(exclude={"supplied"}), supplied=tuple(dict.fromkeys(body.supplied))
    )
    context.store.items.add(unit.serial, said, who=who)
    return said


ZIP = "application/zip"
ARCHIVE_S = 3600.0
"""How long an archive may take: a static log of two days has 4 GB."""
PIECE_BYTES = 1_000_000
LOOK_S = 0.1
"""How often the file is looked at for more."""


@router.get(
    "/api/units/{serial:path}/archive",
    **answers(None, "All that stands behind a unit's calibrations", 404, 429, 503, sends={ZIP: BYTES}),
)
async def show_archive(unit: KnownUnit, heavy: Heavy) -> Response:
    """One zip with every revision, run, pose and sample, and the trail; `calrig verify` checks it.

    Another process writes it into a file, which is sent as it grows.
    """
    name = re.sub(r"[^A-Za-z0-9._-]", "_", unit.serial)
    headers = {
        "Content-Disposition": f'attachment; filename="archive-{name}.zip"',
        "Content-Encoding": "identity",  # it is packed
    }
    try:
        file = NamedTemporaryFile(prefix="calrig-")  # noqa: SIM115 (closed with the last piece)
        work = partial(write_archive, unit.serial, Path(file.name))
        written = asyncio.ensure_future(heavy.with_store(work, longest_s=ARCHIVE_S))
        pieces = _growing(file, written)
        first = await anext(pieces)  # what is wrong with the store is told in place of it
    except OSError as error:
        raise HTTPException(503, no_room(error.strerror)) from error
    return StreamingResponse(_all(first, pieces), media_type=ZIP, headers=headers)


async def _growing(file: IO[bytes], written: asyncio.Future[None]) -> AsyncGenerator[bytes]:
    """What another process writes into a file, as it comes; it ends if nobody takes any more."""
    try:
        with file:
            is_whole = False
            while not is_whole:
                is_whole = written.done()
                while data := await run_in_threadpool(file.read, PIECE_BYTES):
                    yield data
                await asyncio.wait({written}, timeout=LOOK_S)
            written.result()
    finally:
        written.cancel()
        await asyncio.gather(written, return_exceptions=True)


async def _all(first: bytes, others: AsyncGenerator[bytes]) -> AsyncIterator[bytes]:
    async with aclosing(others):
        yield first
        async for piece in others:
            yield piece


# Last: their paths would take those above for parts of a serial number.
CSV = "text/csv; charset=utf-8"


@router.get(
    "/api/units",
    **answers(list[ListedUnit], "Every unit, by serial number", 422, sends={"text/csv": TEXT}),
)
def list_units(
    context: Context,
    q: Annotated[str | None, Query(max_length=200, description="Part of the serial, in any case.")] = None,
    verdict: Annotated[UnitVerdict | None, Query(description="Of the revision in force.")] = None,
    due: UnitDue | None = None,
    change: UnitChange | None = None,
    format: Literal["json", "csv"] | None = None,
    accept: Annotated[str, Header()] = "",
) -> object:
    """Each with its revision in force, its latest calibration, the last change, and when it is due.

    `due=soon` is within 30 days, `due=none` without a date; `verdict=none` without a revision in force.
    `format=csv` or `Accept: text/csv` gives a table with the same names.
    """
    found = histories(context.store)
    units = listed_units(context.store, found, context.due_dates(found))
    wanted = UnitFilter(q or None, verdict, due, change)
    kept = [unit for unit in units if wanted.takes(unit)]
    if format == "csv" or (format is None and prefers_csv(accept)):
        headers = {"Content-Disposition": 'attachment; filename="units.csv"'}
        return Response(units_csv(kept), media_type=CSV, headers=headers)
    return kept


class UnitWithRuns(ListedUnit):
    """A sensor and all its runs, newest first."""

    runs: list[RunAnswer]
    active_run_id: str | None = Field(description="The run that the calibration in force is from.")


@router.get("/api/units/{serial:path}", **answers(UnitWithRuns, "One unit", 404))
def show_unit(unit: KnownUnit, context: Context) -> object:
    """With all its runs, newest first."""
    runs, _ = context.store.runs.page(unit=unit.serial, limit=EVERY_RUN)
    in_force = context.store.revisions.in_force(unit.serial)
    found = histories(context.store, [unit.serial])
    (listed,) = listed_units(context.store, found, context.due_dates(found, [unit.serial]), [unit.serial])
    return {
        **dict(listed),
        "runs": with_doubts(context.store, runs),
        "active_run_id": in_force and in_force.run_id,
    }


@router.delete(
    "/api/units/{serial:path}",
    **answers(None, "Remove a unit that nothing is known of", 404, 409, role="releaser", status=204),
)
def remove_unit(serial: str, context: Context, who: Who) -> None:
    """As one is left whose runs were moved to their right serial number. 409 where it has runs."""
    context.store.units.remove(serial, who=who)
