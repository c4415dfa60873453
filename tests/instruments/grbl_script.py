"""A GRBL controller that says what a test tells it to, line by line as stages.md has them."""

from __future__ import annotations

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
IDLE = "<Idle|MPos:0.000,0.000,0.000|FS:0,0>"
MODAL = "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0"
GO = "G21 G90 G94"
"""What stands before each of calrig's moves."""
SETTINGS = {
    10: "1", 13: "0", 20: "0", 21: "0", 22: "1",
    100: "250.000", 101: "80.000", 110: "1200.000", 111: "600.000",
    120: "80.000", 121: "40.000", 130: "180.000", 131: "90.000",
}  # fmt: skip


class Script:
    """Answers `ok` unless told otherwise; its report never changes by itself."""

    def __init__(self):
        self.report = IDLE
        self.modal = MODAL
        self.settings = dict(SETTINGS)
        self.answers: dict[str, bytes | list[bytes]] = {}
        self.lines: list[str] = []
        self.resets = 0
        self.silent = False
        self._tail = b""

    def receive(self, data: bytes) -> bytes:
        if self.silent:
            return b""
        said = b""
        for byte in (data[k : k + 1] for k in range(len(data))):
            if byte == b"?":
                said += self.report.encode() + b"\r\n"
            elif byte == b"\x18":
                self.resets += 1
                self.modal = MODAL
                said += BANNER
            elif byte in b"\r\n":
                line, self._tail = self._tail.decode(), b""
                self.lines.append(line)
                said += self._answer(line)
            elif byte not in b"!~\x85":
                self._tail += byte
        return said

    def emit(self) -> bytes:
        return b""

    def _answer(self, line: str) -> bytes:
        told = self.answers.get(line)
        if isinstance(told, list):
            told = told.pop(0) if told else None
        if told is not None:
            return told
        if line == "$G":
            return f"[GC:{self.modal}]\r\nok\r\n".encode()
        if line == "$I":
            return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line.startswith("T"):
            self.modal = self.modal.replace("T0", line)
        if line == "$$":
            return (
                b"".join(b"$%d=%s\r\n" % (n, value.encode()) for n, value in self.settings.items())
                + b"ok\r\n"
            )
        return b"ok\r\n"
