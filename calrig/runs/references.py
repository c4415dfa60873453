"""Whether what a rig measures by has a certificate that is still in date."""

from __future__ import annotations

from datetime import UTC, datetime

from calrig.analysis.errors import Conflict
from calrig.laboratory import STANDARDS
from calrig.settings import RigSettings

CALLED = dict(zip(STANDARDS, ("the stage", "the thermometer", "the time base"), strict=True))


def overdue_says(rig: RigSettings) -> list[str]:
    """A sentence for each standard whose certificate is overdue today (UTC)."""
    today = datetime.now(UTC).date()
    said = []
    for key in STANDARDS:
        standard = getattr(rig, key)
        if standard is not None and standard.due is not None and today > standard.due:
            named = f" {standard.certificate}" if standard.certificate else ""
            said.append(
                f"The certificate{named} of {CALLED[key]} of rig {rig.name} was due on {standard.due} and is "
                "overdue."
            )
    return said


def require_in_date(rig: RigSettings) -> None:
    """Raises Conflict where a certificate is overdue and the rig is not to measure then."""
    if rig.overdue == "refuse" and (said := overdue_says(rig)):
        raise Conflict(
            f"{' '.join(said)} Nothing was moved: have it calibrated and enter its new certificate, or set "
            'overdue = "flag" for this rig'
        )
