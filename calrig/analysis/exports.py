"""A unit's calibration in the formats of other programs: those of a revision, and those of its noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

from calrig.analysis.errors import Conflict
from calrig.analysis.noise_studies import noise_of_unit
from calrig.export.c_header import c_header
from calrig.export.formats.ardupilot import ardupilot
from calrig.export.formats.imu_tk import imu_tk
from calrig.export.formats.imucal import imucal
from calrig.export.formats.noise_yaml import kalibr, vins
from calrig.export.formats.px4 import px4
from calrig.export.formats.triads import NotHeldError
from calrig.store import Store
from calrig.store.issued import Revision
from calrig.store.records import Document

RevisionFormat = Literal["c-header", "px4", "ardupilot", "imu-tk", "imucal"]
NoiseFormat = Literal["kalibr", "vins"]
REVISION_FORMATS: tuple[str, ...] = get_args(RevisionFormat)
NOISE_FORMATS: tuple[str, ...] = get_args(NoiseFormat)

_OF_REVISION: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "c-header": c_header,
    "px4": px4,
    "ardupilot": ardupilot,
    "imu-tk": imu_tk,
    "imucal": imucal,
}
_OF_NOISE: dict[str, Callable[[Mapping[str, Any], str], str]] = {"kalibr": kalibr, "vins": vins}


def exported(revision: Revision, format_: str) -> str:
    """A revision as a text of a `RevisionFormat`.

    Raises:
        Conflict: it cannot hold what the revision says.
    """
    return exported_document(
        revision.document, format_, f"revision {revision.revision} of unit {revision.unit!r}"
    )


def exported_document(document: Mapping[str, Any], format_: str, what: str) -> str:
    """A document as such a text; `what` it is called where it cannot be, as `exported`."""
    try:
        return _OF_REVISION[format_](document)
    except ValueError as error:
        in_ = "C" if format_ == "c-header" else format_
        raise Conflict(f"{what} cannot be put into {in_}: {error}") from error


def exported_noise(
    store: Store,
    unit: str,
    format_: str,
    carried_out: Callable[[Callable[[], Document]], Document] = lambda function: function(),
) -> str:
    """The noise of a unit's latest static log as a text of a `NoiseFormat`; as `noise_of_unit`.

    Raises:
        Conflict: there is no such log, or it does not show what the format needs.
    """
    report, run = noise_of_unit(store, unit, carried_out)
    try:
        return _OF_NOISE[format_](report, f"unit {unit}, static run {run.id}")
    except NotHeldError as error:
        raise Conflict(f"run {run.id}: {error}") from error
