"""An ESP301 that says what a test tells it to."""

from __future__ import annotations

REPLIES = {
    "VE?": "ESP301 Version 3.0.1 6/1/99",
    "1ID?": "URS75BCC, SN B101",
    "1TP?": "0.0000",
    "1MD?": "1",
    "1PA?": "0",
    "1VA?": "20",
    "1AC?": "80",
    "1SL?": "-170.5",
    "1SR?": "170.5",
}


class Script:
    """A controller that says what a test tells it to, line by line as stages.md has them."""

    def __init__(self, line_end: bytes = b"\r\n"):
        self.replies = dict(REPLIES)
        self.once: dict[str, list[bytes]] = {}
        self.refuse: dict[str, int] = {}
        self.errors: list[int] = []
        self.lines: list[str] = []
        self.silent = False
        self._line_end = line_end
        self._tail = b""

    def receive(self, data: bytes) -> bytes:
        *lines, self._tail = (self._tail + data).split(b"\r")
        return b"" if self.silent else b"".join(self._answer(line.decode()) for line in lines)

    def emit(self) -> bytes:
        return b""

    def _answer(self, line: str) -> bytes:
        self.lines.append(line)
        if self.once.get(line):
            return self.once[line].pop(0)
        if line == "TE?":
            reply = str(self.errors.pop(0) if self.errors else 0)
        elif line in self.replies:
            reply = self.replies[line]
        else:
            refused = [code for start, code in self.refuse.items() if line.startswith(start)]
            self.errors += refused
            if not refused and f"{line[:3]}?" in self.replies:
                self.replies[f"{line[:3]}?"] = line[3:]
            return b""
        return reply.encode() + self._line_end

    def commands(self) -> list[str]:
        return [line for line in self.lines if not line.endswith("?")]
