"""What a run was measured by, and what shows that it is traceable, as its provenance kept it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date, datetime
from typing import Any

from calrig.calibration.uncertainty import Reference, ReferenceFigures
from calrig.export.certificate.content import Row, Standard
from calrig.export.certificate.rounding import by_itself
from calrig.store.records import reference_of

Document = Mapping[str, Any]
ROLES = (
    ("reference", "Angle of the stage"),
    ("thermometer", "Temperature"),
    ("time_base", "Time"),
)
"""Keys of a rig's settings, and what each is the standard of."""
WITHOUT = {
    "thermometer": "the sensor's own die thermometer",
    "time_base": "the board's own clock",
}
"""What measures where nothing else is stated."""


def standards_of(document: Document, measured_at: datetime | None) -> tuple[Standard, ...]:
    """The standards that a calibration document rests on; what was not stated of them is None.

    Args:
        document: CONTRACT section 6.
        measured_at: when it was measured, which a due date is held against.
    """
    provenance = document["provenance"]
    rig = provenance.get("rig") or {}
    stated = tuple(_standard(key, role, rig, provenance, measured_at) for key, role in ROLES)
    if "elevation_std_deg" in document:
        return (_gravity(document), *stated[1:])
    by_map = document["uncertainty"].get("reference")
    return stated if by_map is None else (_map(by_map), *stated)


def _map(by_map: Document) -> Standard:
    """The stage's map that elevations rest on, which has no certificate but what it was solved from."""
    return Standard(
        role="Error of the stage",
        what=by_map["says"],
        uncertainty=f"standard uncertainty {by_itself(by_map['std_deg'])}°, {by_map['distribution']}",
        certificate=None,
        file="the map",
        sha256=by_map["sha256"],
        issued_by=None,
        issued_on=None,
        due=None,
        overdue=None,
    )


def _gravity(document: Document) -> Standard:
    """What the angles of a joint solution rest on, which no certificate is needed for."""
    worth = by_itself(document["uncertainty"]["reference_deg"])
    return Standard(
        role="Angle",
        what="gravity and the full turn, by stage, mounts and unit solved together",
        uncertainty=f"standard uncertainty {worth}°, normal",
        certificate=None,
        file=None,
        sha256=None,
        issued_by=None,
        issued_on=None,
        due=None,
        overdue=None,
    )


def traceable(document: Document) -> str:
    """To what the angles of a calibration document are traceable, a sentence."""
    if "elevation_std_deg" in document:
        return (
            "Angles rest on gravity and the full turn, by a joint solution of several mounts: on no "
            "certificate of the stage."
        )
    by_map = document["uncertainty"].get("reference")
    if by_map is not None:
        return f"Angles rest on {by_map['says']}: on gravity and the full turn, by several mounts."
    stated = (document["provenance"].get("rig") or {}).get("reference") or {}
    if stated.get("certificate") is None:
        return "No certificate of the stage is stated: angles are traceable no further than the stage's own."
    by = f" of {stated['issued_by']}" if stated.get("issued_by") else ""
    return f"Angles are traceable to the certificate {stated['certificate']}{by}."


def stated_reference(document: Document) -> Reference | None:
    """What the stage was worth to a calibration document; None where nobody said, or it is solved jointly."""
    by_map = document["uncertainty"].get("reference")
    if by_map is not None:
        return ReferenceFigures.from_dict(by_map).reference
    if "elevation_std_deg" in document:
        return None
    return reference_of(document["provenance"])


def overdue(stated: Document, measured_at: datetime | None) -> bool | None:
    """Whether a standard's due date had passed when it was used; None where no date is stated."""
    due = _day(stated.get("due"))
    return None if due is None or measured_at is None else measured_at.date() > due


def _standard(
    key: str, role: str, rig: Document, provenance: Document, measured_at: datetime | None
) -> Standard:
    stated = rig.get(key) or {}
    return Standard(
        role=role,
        what=stated.get("name") or WITHOUT.get(key) or _stage(provenance),
        uncertainty=_uncertainty(stated),
        certificate=stated.get("certificate"),
        file=stated.get("file"),
        sha256=stated.get("sha256"),
        issued_by=stated.get("issued_by"),
        issued_on=_day(stated.get("issued_at")),
        due=_day(stated.get("due")),
        overdue=overdue(stated, measured_at),
    )


def _stage(provenance: Document) -> str:
    stage = provenance.get("stage")
    if stage is None:
        return "the stage that the imported poses were taken on"
    return " ".join(str(part) for part in (stage["driver"], stage.get("firmware")) if part)


def _uncertainty(stated: Document) -> str | None:
    if stated.get("std_deg") is None:
        return None
    distribution = stated.get("distribution", "rectangular")
    return f"standard uncertainty {by_itself(stated['std_deg'])}°, {distribution}"


def _day(value: str | date | None) -> date | None:
    return date.fromisoformat(value) if isinstance(value, str) else value


def equipment_of(provenance: Document) -> tuple[Row, ...]:
    """The devices that measured, as they said who they are."""
    rig, stage, board = (provenance.get(key) or {} for key in ("rig", "stage", "board"))
    rows = [("Rig", rig.get("name"))]
    rows += [(f"Stage, {key.replace('_', ' ')}", stage.get(key)) for key in ("driver", "firmware")]
    rows += [(f"Board, {key.replace('_', ' ')}", board.get(key)) for key in ("driver", "firmware", "chip")]
    rows += [
        ("Accelerometer range (g)", board.get("accel_range_g")),
        ("Gyro range (°/s)", board.get("gyro_range_dps")),
        ("Computer", provenance.get("host")),
        ("Imported from", provenance.get("imported_from")),
    ]
    return tuple((name, str(value)) for name, value in rows if value not in (None, ""))
