"""What a look at the ports answers."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from pydantic import Field

from calrig.api.models import Answer
from calrig.instruments.scan import Kind


class FoundAnswer(Answer):
    """A port and who answers there; `busy` and `no permission` are ports that did not open."""

    port: str
    kind: Kind
    driver: str | None
    identity: str
    axis: int | None
    baudrate: int | None
    usb_id: str | None
    usb_serial: str | None
    description: str


class ScanAnswer(Answer):
    """Every port there is, by name."""

    found: list[FoundAnswer]
    stanza: str = Field(description="For calrig.toml; empty where no stage was found.")
