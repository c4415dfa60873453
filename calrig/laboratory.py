"""What is configured for certificates: the laboratory, and the certificates of what it measures by."""

import hashlib
from datetime import date
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Words = Annotated[str, Field(min_length=1, max_length=500)]
STANDARDS = ("reference", "thermometer", "time_base")
"""Of a rig: what it measures by."""
Overdue = Literal["flag", "refuse"]
"""How a run on a reference with an overdue certificate is handled: with a warning, or refused."""


class Strict(BaseModel):
    """Settings: a key that is not known is a mistake, and nothing changes them."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StandardSettings(Strict):
    """What shows that a standard is traceable: its certificate, kept with each run as it was then.

    `file` is the certificate's file, next to the configuration: its hash is stored. `name` is what the
    standard is called.
    """

    name: Words | None = None
    certificate: Words | None = None
    issued_by: Words | None = None
    issued_at: date | None = None
    due: date | None = None
    file: Words | None = None
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None

    @model_validator(mode="after")
    def _is_due_later(self) -> Self:
        if self.issued_at is not None and self.due is not None and self.due < self.issued_at:
            raise ValueError(f"due {self.due} is before issued_at {self.issued_at}")
        return self

    def read_beside(self, folder: Path) -> Self:
        """The same with the hash of its file.

        Raises:
            ValueError: the file cannot be read, or is not the one whose hash is stated.
        """
        if self.file is None:
            return self
        try:
            sha256 = hashlib.sha256((folder / self.file).read_bytes()).hexdigest()
        except OSError as error:
            raise ValueError(f"file {self.file}: cannot be read ({error.strerror})") from error
        if self.sha256 not in {None, sha256}:
            raise ValueError(f"file {self.file}: its SHA-256 is {sha256}, not what is stated")
        return self.model_copy(update={"sha256": sha256})


_PATHS = {
    "logo": Path.is_file,
    "fonts": Path.is_dir,
    "signing_key": Path.is_file,
    "signing_certificate": Path.is_file,
}
_NOT_STATED = {*_PATHS, "country"}
"""What of a laboratory a certificate on paper has no words for."""


class LaboratorySettings(Strict):
    """Who issues certificates, a `[laboratory]`; what is not stated here, a certificate does not state.

    Attributes:
        place: where calibrations are made, if not at the address.
        accreditation: text of the accreditation; without it no certificate has any mark of one.
        decision_rule: what was agreed on decision rules, in addition to the limit's own rule.
        authorised_by: who is responsible for certificates; else who released the calibration.
        logo: for the head of certificates, an SVG, PNG or JPEG file.
        fonts: a folder of fonts for what typst's own have no characters for.
        country: of the laboratory, two letters of ISO 3166-1, for digital certificates.
        signing_key, signing_certificate: PEM files that certificates are signed with, digital and PDF.
    """

    name: Words | None = None
    address: Words | None = None
    place: Words | None = None
    accreditation: Words | None = None
    decision_rule: Words | None = None
    authorised_by: Words | None = None
    logo: Words | None = None
    fonts: Words | None = None
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    signing_key: Words | None = None
    signing_certificate: Words | None = None

    @model_validator(mode="after")
    def _signs_with_both(self) -> Self:
        if (self.signing_key is None) != (self.signing_certificate is None):
            raise ValueError("signing_key and signing_certificate go together")
        return self

    def as_stated(self) -> dict[str, str | None]:
        """What a certificate says of it, by name."""
        return self.model_dump(exclude=_NOT_STATED)

    def read_beside(self, folder: Path) -> Self:
        """The same with whole paths.

        Raises:
            ValueError: one of them is not there.
        """
        found = {}
        for name, is_there in _PATHS.items():
            said = getattr(self, name)
            if said is None:
                continue
            path = (folder / said).resolve()
            if not is_there(path):
                raise ValueError(f"{name} {said}: is not there")
            found[name] = str(path)
        return self.model_copy(update=found)
