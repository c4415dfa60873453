"""Count how large and how deep the house is: `python -m tests.studies.structure`; half a minute.

Static: lines and modules of `calrig/`, modules with a single importer (without routers, commands, exporters
and `__init__`), untyped dictionaries. Dynamic: a run of six poses, started over HTTP, on a rig in virtual
time: the modules and functions that it executes, the depth of `Port.write`, and the calls from one module to
another between the route and the wire.
"""

from __future__ import annotations

import ast
import re
import sys
import tempfile
import threading
import traceback
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

TREE = Path(__file__).parents[2] / "calrig"
NOT_COUNTED = re.compile(r"calrig\.(api|cli|export)(\.|$)")
"""Each router, command and exporter has one importer by its nature: what gathers them."""


def name_of(file: Path) -> str:
    """The name by which a file of the package is imported."""
    return ".".join(file.relative_to(TREE.parent).with_suffix("").parts).removesuffix(".__init__")


def static() -> Iterator[tuple[str, int]]:
    """What is counted in the text."""
    texts = {name_of(file): file.read_text(encoding="utf-8") for file in TREE.rglob("*.py")}
    importers: dict[str, set[str]] = defaultdict(set)
    for module, text in texts.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module:
                for name in {
                    node.module,
                    *(f"{node.module}.{alias.name}" for alias in node.names),
                } & texts.keys():
                    importers[name].add(module)
    fronts = {name_of(file) for file in TREE.rglob("__init__.py")}
    single = [
        m for m in texts if m not in fronts and not NOT_COUNTED.match(m) and len(importers[m] - {m}) == 1
    ]
    yield "lines", sum(text.count("\n") for text in texts.values())
    yield "modules", len(texts)
    yield "modules with a single importer", len(single)
    yield "dict[str, Any]", sum(text.count("dict[str, Any]") for text in texts.values())
    yield "untyped documents", sum(len(re.findall(r"\bDocument\b", text)) for text in texts.values())


class Watch:
    """Record the functions of `calrig/`, without its simulator, that threads enter; and stacks of writes."""

    def __init__(self) -> None:
        self.entered: set[tuple[str, str]] = set()
        self.writes: list[list[str]] = []
        self.begins: list[str] = []
        self._files: dict[str, str | None] = {}

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """A profile function; of Python's calls alone."""
        if event != "call":
            return
        module = self._module(frame.f_code.co_filename)
        if module is None:
            return
        self.entered.add((module, frame.f_code.co_qualname))
        if frame.f_code.co_qualname == "Port.write":
            self.writes.append(self._stack(frame))
        elif frame.f_code.co_qualname == "Worker.__init__" and not self.begins:
            self.begins = self._stack(frame)

    def _module(self, file: str) -> str | None:
        if file not in self._files:
            path = Path(file)
            own = path.is_relative_to(TREE) and not path.is_relative_to(TREE / "simulator")
            self._files[file] = name_of(path) if own else None
        return self._files[file]

    def _stack(self, frame: FrameType) -> list[str]:
        frames = [one for one, _ in traceback.walk_stack(frame)]
        return [module for one in reversed(frames) if (module := self._module(one.f_code.co_filename))]


def hops(stack: list[str]) -> int:
    """How often a stack goes from one module to another."""
    return sum(before != after for before, after in pairwise(stack))


@contextmanager
def watching(watch: Watch) -> Iterator[None]:
    """Every thread that begins meanwhile is watched; those of before are not."""
    threading.setprofile(watch)
    sys.setprofile(watch)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def of_a_run() -> Iterator[tuple[str, int]]:
    """What a run of six poses enters."""
    sys.path.insert(0, str(TREE.parent / "tests"))
    from support import QUICK, fast, known_as, running_service, serving
    from virtual_time import virtual_rig
    from virtual_time.clock import VirtualClock

    clock, watch = VirtualClock(20.0), Watch()
    with tempfile.TemporaryDirectory() as folder, virtual_rig(fast({}), clock) as simulated:
        rig = known_as("bench-1", simulated).model_copy(update={"simulated": {}})
        with (
            running_service(Path(folder) / "calrig.db", rig) as service,
            watching(watch),
            serving(service) as client,
        ):
            watch.entered.clear()
            run = client.post("/api/runs", json={"unit": "AS-0042", "plan": QUICK}).raise_for_status().json()
            with client.stream("GET", f"/api/runs/{run['id']}/events") as events:
                assert '"completed"' in "".join(events.iter_lines()), "the run has failed"
    clock.stop()
    deepest = max((stack for stack in watch.writes if stack[0] == watch.begins[-1]), key=len)
    yield "modules that a run of six poses executes", len({module for module, _ in watch.entered})
    yield "functions that it executes", len(watch.entered)
    yield "frames of calrig above the deepest Port.write", len(deepest)
    yield "hops between modules from POST to the wire", hops(watch.begins) + hops(deepest)


def main() -> None:
    """Prints all."""
    for what, count in (*static(), *of_a_run()):
        print(f"{what:50} {count:7d}")  # noqa: T201


if __name__ == "__main__":
    main()
