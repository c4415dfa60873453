"""A GRBL controller that says what a test tells it to, line by line as stages.md has them."""

from __future__ import annotations

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
IDLE = "<Idle|MPos:0.000,0.000,0.000|FS:0,0>"
MODAL = "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0"
GO = "G21 G90 G94 T211 G1"
"""What each of calrig's moves begins with."""
SETTINGS = {
    1: "255", 10: "1", 13: "0", 20: "1", 21: "0", 22: "1",
    100: "250.000", 101: "80.000", 110: "1200.000", 111: "600.000",
    120: "80.000", 121: "40.000", 130: "180.000", 131: "90.000",
}  # fmt: skip


class Script:
    """Answers `ok` unless told otherwise; its report never changes by itself.

    It keeps T, F and S as recorded from GRBL 1.1h: a line without T makes it 0, a reset all three.

    `plays` are what a line or a reset sets off, each message with its delay in seconds. After ALARM:1 and
    ALARM:2 it answers nothing, and takes no reset before it has said so.
    """

    def __init__(self):
        self.report = IDLE
        self.modal = MODAL
        self.settings = dict(SETTINGS)
        self.answers: dict[str, bytes | list[bytes]] = {}
        self.lines: list[str] = []
        self.resets = 0
        self.silent = False
        self.plays: dict[str, list[tuple[float, str]]] = {}
        self.now_s = lambda: 0.0
        self._due: list[tuple[float, str]] = []
        self._locked = False
        self._tail = b""

    def receive(self, data: bytes) -> bytes:
        if self.silent:
            return b""
        said = self.emit()
        for byte in (data[k : k + 1] for k in range(len(data))):
            if self._locked and (byte != b"\x18" or self._due):
                continue
            if byte == b"?":
                said += self.report.encode() + b"\r\n"
            elif byte == b"\x18":
                self.resets += 1
                self.modal = MODAL
                self._locked = False
                said += b"" if self._plays("\x18") else BANNER
            elif byte in b"\r\n":
                line, self._tail = self._tail.decode(), b""
                self.lines.append(line)
                said += self._answer(line)
            elif byte not in b"!~\x85":
                self._tail += byte
        return said

    def emit(self) -> bytes:
        """What is due by now."""
        due = [text for at_s, text in self._due if at_s <= self.now_s()]
        self._due = self._due[len(due) :]
        self._locked |= any(text.startswith(("ALARM:1\r", "ALARM:2\r")) for text in due)
        return "".join(due).encode("latin-1")

    def _answer(self, line: str) -> bytes:
        if self._plays(line):
            return b""
        told = self.answers.get(line)
        if isinstance(told, list):
            told = told.pop(0) if told else None
        if told is not None:
            return told
        if line == "$G":
            return f"[GC:{self.modal}]\r\nok\r\n".encode()
        if line == "$I":
            return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line[:1] not in ("$", ""):
            return self._execute(line.split())
        if line == "$$":
            return (
                b"".join(b"$%d=%s\r\n" % (n, value.encode()) for n, value in self.settings.items())
                + b"ok\r\n"
            )
        return b"ok\r\n"

    def _plays(self, cause: str) -> bool:
        self._due += [(self.now_s() + delay_s, text) for delay_s, text in self.plays.get(cause, ())]
        return cause in self.plays

    def _execute(self, words: list[str]) -> bytes:
        given = {word[0]: word for word in ["T0", *words] if word[0] in "TFS"}
        in_force = [given.get(word[0], word) for word in self.modal.split()]
        if "G1" in words and "F0" in in_force:
            return b"error:22\r\n"
        self.modal = " ".join(in_force)
        return b"ok\r\n"
