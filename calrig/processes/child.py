"""What a working process does: one piece after another, within its memory, as long as its parent lives.

Imports nothing of calrig: what a piece is about comes with it. A piece and its reply are 8 bytes of length
and a pickle, the reply's of `(None, what the function gave)` or `(what it raised, None)`.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import sys
import threading
import time
from typing import Any

HEAD_BYTES = 8
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
        reply = _reply(pieces.read(int.from_bytes(head)))
        try:
            replies.write(len(reply).to_bytes(HEAD_BYTES))
            replies.write(reply)
            replies.flush()
        except BrokenPipeError:
            os._exit(1)  # nobody waits for it


def _reply(piece: bytes) -> bytes:
    try:
        return _pickled((None, pickle.loads(piece)()))  # noqa: S301 (from our own parent)
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
