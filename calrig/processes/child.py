"""Worker process: carries out one task after another, within its memory limit, while its parent lives.

Imports nothing of calrig: a task brings its own function. A task is 8 bytes of length and a pickle of
`(function, whether it reports progress)`. The reply is a byte for its type, 8 bytes of length and a pickle:
any number of progress values, then `(None, result)` or `(exception, None)`.
"""

import os
import pickle
import resource
import signal
import struct
import sys
import threading
import time
from typing import Any, BinaryIO

HEAD_BYTES = 8
REPLY, PROGRESS = b"r", b"p"
FRACTION = struct.Struct("<d")
LOOK_S = 0.5
"""How soon a process that works notices that the one it works for was killed."""
NICENESS = 5
"""The process that holds the ports goes first."""


def main(most_bytes: int, parent: int) -> None:
    """Carries out what comes by standard input until it ends.

    Args:
        most_bytes: of memory.
        parent: the process that it works for, and does not outlive.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C goes to all; the parent ends its own
    os.nice(NICENESS)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most_bytes if hard == resource.RLIM_INFINITY else min(most_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    threading.Thread(target=_end_with, args=(parent,), daemon=True, name="watches the parent").start()
    pieces, replies = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no reply
    while head := pieces.read(HEAD_BYTES):
        _send(replies, REPLY, _reply(pieces.read(int.from_bytes(head)), replies))


def _send(replies: BinaryIO, kind: bytes, content: bytes) -> None:
    try:
        replies.write(kind + len(content).to_bytes(HEAD_BYTES))
        replies.write(content)
        replies.flush()
    except BrokenPipeError:
        os._exit(1)  # nobody waits for it


def _reply(piece: bytes, replies: BinaryIO) -> bytes:
    def progress(fraction: float) -> None:
        _send(replies, PROGRESS, FRACTION.pack(fraction))

    try:
        function, tells = pickle.loads(piece)  # noqa: S301 (from our own parent)
        return _pickled((None, function(progress=progress) if tells else function()))
    except Exception as error:  # noqa: BLE001 (whatever it is, the one who asked is told)
        error.__traceback__ = None  # it holds on to what filled the memory
        return _pickled((error, None))


def _pickled(reply: Any) -> bytes:
    return pickle.dumps(reply, pickle.HIGHEST_PROTOCOL)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
