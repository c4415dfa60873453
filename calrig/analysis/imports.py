"""The import of poses from a file: read and fitted without a store; and the checks of serial numbers."""

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import calrig
from calrig.analysis.errors import Invalid
from calrig.calibration.regression import ASSUMED, AssumedReference
from calrig.calibration.results import FittedResult, build_result
from calrig.export.calibration_document import calibration_content
from calrig.export.poses_csv import FileReference, PoseColumns, read_run
from calrig.model.result import MOST_REFERENCE_STD_DEG, StatedKind
from calrig.settings import ReferenceSettings, RigSettings
from calrig.store.records import AcceptedEffect, Document, as_applied, doubt_of, reference_of

READING = 0.25
"""Share of an import that goes into reading its file."""


@dataclass(frozen=True, slots=True)
class ImportOrigin:
    """Where imported poses were measured, and the reference of their angles.

    Attributes:
        rig: name; None if none is known.
        of_rig: that the rig's configuration states; None without such a rig or statement.
        stated: for this import; takes precedence over the file's columns, and these over the rig's.
        assumed: whether the reference may err, as stated for this import; None for what its rig says.
    """

    rig: str | None = None
    of_rig: ReferenceSettings | None = None
    stated: ReferenceSettings | None = None
    assumed: AssumedReference | None = None

    @classmethod
    def of(
        cls,
        rig: str | None,
        configured: Sequence[RigSettings] = (),
        std_deg: float | None = None,
        kind: StatedKind | None = None,
        certificate: str | None = None,
        assumed: AssumedReference | None = None,
    ) -> Self:
        """Return the origin as requested, with the reference of a configured rig of this name.

        Args:
            rig: name, also of a rig that is not configured.
            configured: the rigs.
            std_deg: stated standard uncertainty of the reference, degrees.
            kind: how its error is shared among poses; None for the usual one.
            certificate: that the uncertainty is taken from.
            assumed: whether it may err (`good`: it does not); None for what the rig says.

        Raises:
            Invalid: the uncertainty is out of its bounds, or a kind or a certificate is stated without it.
        """
        if std_deg is None:
            for name, given in (("reference_kind", kind), ("reference_certificate", certificate)):
                if given is not None:
                    raise Invalid(f"{name} {given!r} states no uncertainty: add reference_std_deg", [name])
        elif certificate is not None and not _is_number(certificate):
            said = f"reference_certificate is no number of 1 to {LONGEST_SERIAL} printable characters"
            raise Invalid(said, ["reference_certificate"])
        elif not 0.0 < std_deg <= MOST_REFERENCE_STD_DEG:
            said = f"reference_std_deg is {std_deg:g}, not above 0 and at most {MOST_REFERENCE_STD_DEG:g}"
            raise Invalid(said, ["reference_std_deg"])
        of_rig = next((one.reference for one in configured if one.name == rig), None)
        stated = None if std_deg is None else _settings(std_deg, kind, certificate)
        return cls(rig, of_rig, stated, assumed)

    def reference(self, of_file: FileReference | None) -> tuple[ReferenceSettings | None, list[str]]:
        """Return the reference that counts, and a warning if the file states another one."""
        in_file = None if of_file is None else _settings(of_file.std_deg, of_file.kind)
        if self.stated is None or in_file is None or _in_words(in_file) == _in_words(self.stated):
            return self.stated or in_file or self.of_rig, []
        return self.stated, [
            f"the file states a reference of {_in_words(in_file)}; the one stated for this import counts, "
            f"{_in_words(self.stated)}"
        ]


def _is_number(certificate: str) -> bool:
    return 0 < len(certificate.strip()) <= len(certificate) <= LONGEST_SERIAL and certificate.isprintable()


def _settings(std_deg: float, kind: StatedKind | None, certificate: str | None = None) -> ReferenceSettings:
    usual = ReferenceSettings(std_deg=std_deg, certificate=certificate)
    return usual if kind is None else usual.model_copy(update={"kind": kind})


def _in_words(reference: ReferenceSettings) -> str:
    return f"{reference.std_deg:g}° ({reference.kind})"


@dataclass(frozen=True, slots=True)
class Imported:
    """What a run is made of: the poses, what was said of the file, and CONTRACT section 2's result.

    `mount_axis` is which of the unit's axes lay along the stage's; there is a result about x alone. `content`
    is that of the unit's next revision, with the effects `accepted`; None where the scale is left open.
    `origin` is the part of the run's provenance that states the rig and its reference, if one is known.
    """

    poses: PoseColumns
    mount_axis: str
    warnings: list[str]
    result: FittedResult | None
    content: Document | None
    accepted: Sequence[AcceptedEffect]
    origin: Document


def read_and_fit(
    file: bytes | Path,
    unit: str,
    origin: ImportOrigin,
    accepted: Sequence[AcceptedEffect],
    progress: Callable[[float], None] | None = None,
) -> Imported:
    """Reads a CSV of poses (CONTRACT section 4) and fits them.

    `file` is what is in it, or its path; `progress` is told the share done, 0 to 1: fitting and keeping tell
    nothing.

    Raises:
        CsvError: the file is bad; says line and column.
    """
    content = file.read_bytes() if isinstance(file, Path) else file
    told = progress and (lambda share: progress(READING * share))
    columns, axis, warnings, of_file = read_run(content, unit, told)
    settings, contradicted = origin.reference(of_file)
    warnings += contradicted
    stated: Document = {}
    if settings is not None and settings.std_deg is not None:  # a map is of the rig's own runs alone
        stated = {"rig": {"name": origin.rig, "reference": settings.model_dump(mode="json")}}
    if origin.assumed is not None:
        stated[ASSUMED] = origin.assumed
    if axis != "x":
        return Imported(columns, axis, warnings, None, None, accepted, stated)
    poses, reference = columns[:], reference_of(stated)
    result = build_result(poses, None, as_applied(accepted), reference, doubt=doubt_of(accepted))
    issued = None
    if result.scale is not None:
        issued = calibration_content(
            unit=unit, rig=origin.rig, poses=poses, result=result, accepted=accepted, reference=reference
        )
    return Imported(columns, axis, warnings, result, issued, accepted, stated)


LONGEST_SERIAL = 100


def check_serial(serial: str) -> None:
    """Raises Invalid unless a serial number has 1 to 100 printable characters without blanks at its ends."""
    if not serial or serial != serial.strip() or not serial.isprintable():
        raise Invalid(
            "a unit's serial number is made of printable characters, without blanks at its ends", ["unit"]
        )
    if len(serial) > LONGEST_SERIAL:
        said = f"a unit's serial number has at most {LONGEST_SERIAL} characters, not {len(serial)}"
        raise Invalid(said, ["unit"])


def provenance(operator: str | None) -> dict[str, Any]:
    """What is known of a run's origin before any device has been asked: program, machine, operator."""
    return {
        "calrig": calrig.__version__,
        "python": platform.python_version(),
        "host": platform.node(),
        "operator": operator,
    }
