"""Which program text it is that decides something: what was decided by another one is decided anew."""

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable


@cache
def sha256_of_program(*parts: str) -> str:
    """SHA-256 of the text of some packages and modules, named as `store` or `store/records.py`."""
    digest = hashlib.sha256()
    for part in parts:
        for name, content in sorted(_texts(files("calrig") / part, part)):
            digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _texts(found: Traversable, name: str) -> Iterator[tuple[str, bytes]]:
    if found.is_dir():
        for part in found.iterdir():
            yield from _texts(part, f"{name}/{part.name}")
    elif name.endswith(".py"):
        yield name, found.read_bytes()
