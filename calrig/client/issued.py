"""What a service has issued of a unit: calibrations, certificates, files for other programs, archives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote, urlencode

from calrig.client.documents import Comparison, Revision
from calrig.client.transport import Transport

if TYPE_CHECKING:
    from calrig.loaded import Calibration


class Issued(Transport):
    """Documents of units."""

    def compare(self, *units: str) -> Comparison:
        """Units side by side; all of them without any."""
        query = urlencode([("unit", unit) for unit in units])
        return Comparison.of(self.get(f"/api/compare?{query}"))

    def calibration(self, unit: str, revision: int | None = None) -> Calibration:
        """A unit's calibration, ready to be applied to readings: the one in force, or the revision."""
        from calrig.export.calibration_file import checked
        from calrig.loaded import Calibration

        path = _calibration(unit, revision)
        return Calibration(checked(self.get(path), self.server + path))

    def calibrations(self, unit: str) -> list[Revision]:
        """Every revision that was issued, the newest first."""
        return Revision.each(self.get(f"{_calibration(unit)}s"))

    def exported(self, unit: str, form: str, revision: int | None = None) -> str:
        """A calibration as it was issued (`json`), or made of it for another program.

        Args:
            unit: serial number.
            form: `c-header`, `px4` and others that `calrig export --format` has.
            revision: else the one in force.

        Raises:
            Refused: there is none, or that form cannot hold it.
        """
        return self.text(_calibration(unit, revision, form))

    def certificate(
        self, unit: str, form: Literal["pdf", "dcc"] = "pdf", revision: int | None = None
    ) -> bytes:
        """The certificate of a calibration: for people, or PTB's XML for programs.

        Raises:
            Refused: there is none, or the service cannot make such a one (501).
        """
        return b"".join(self.pieces(_calibration(unit, revision, form)))

    def archive(self, unit: str, file: str | Path) -> int:
        """All that stands behind a unit, a zip that `calrig verify` checks, into a file; gives its bytes.

        Raises:
            InputError: the file is there, or cannot be made.
            Refused: there is no such unit; no file is left then, nor where the line breaks.
        """
        from calrig.export.new_file import write_new

        return write_new(Path(file), self.pieces(f"/api/units/{quote(unit, safe='')}/archive"))


def _calibration(unit: str, revision: int | None = None, form: str | None = None) -> str:
    wanted = {"revision": revision, "format": form}
    query = urlencode({key: value for key, value in wanted.items() if value is not None})
    path = f"/api/units/{quote(unit, safe='')}/calibration"
    return f"{path}?{query}" if query else path
