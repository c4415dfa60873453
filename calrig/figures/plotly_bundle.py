"""A partial bundle of plotly.js: its core and the traces that calrig draws, cut out of the whole bundle.

The script in plotly's wheel is one esbuild bundle. Each of its CommonJS modules is wrapped,
`var X=W((exports,module)=>{…});`, and runs only when `X()` is called; the entry module registers every kind
of trace. Without the traces that calrig does not draw, most modules are never called and are left out: a
quarter of the bytes remain, all unchanged. A bundler would do the same, but needs Node.js at build time.
"""

import re
from collections.abc import Collection, Mapping

TRACES = ("bar",)
"""What is drawn beside `scatter`, which belongs to the core."""

_WRAPPER = re.compile(r"[,;]?(?:var )?([\w$]+)=\(e,t\)=>\(\)=>\{try\{return t\|\|e\(\(t=\{exports:\{\}\}\)")
_REGISTERED = re.compile(r"\.register\(\[((?:[\w$]+\(\),?)+)\]\)")
_CALL = re.compile(r"(?<![\w$.])([\w$]+)\(\)")
_FORWARDS = re.compile(r"exports=([\w$]+)\(\)\}\);$")
_TRACE = re.compile(r'moduleType:"trace",name:"(\w+)"')


class BundleError(ValueError):
    """The script is not built the way this module knows; says what is missing."""


def partial_bundle(script: str, traces: Collection[str] = TRACES) -> str:
    """Return the script with the core and these traces alone.

    `script` is plotly.min.js as plotly's wheel has it; `traces` are names, such as `bar`.

    Raises:
        BundleError: the script has no such modules, or no such trace.
    """
    wrapper = _WRAPPER.search(script)
    if wrapper is None:
        raise BundleError("plotly.js: no wrapped modules were found")
    head, modules, entry, tail = _taken_apart(script, wrapper[1])
    listed = _REGISTERED.search(modules[entry])
    if listed is None:
        raise BundleError("plotly.js: its entry module registers no traces")
    calls = listed[1].split(",")
    drawn = {call: name for call in calls if (name := _trace_of(modules, call[:-2])) in traces}
    if missing := set(traces) - set(drawn.values()):
        raise BundleError(f"plotly.js: no trace is called {', '.join(sorted(missing))}")
    modules[entry] = modules[entry].replace(listed[1], ",".join(drawn))
    kept = _called(modules, [entry, *_always(modules, wrapper[1]), *_calls(head, modules)])
    return head + "".join(text for name, text in modules.items() if name in kept) + tail


def _taken_apart(script: str, wrapper: str) -> tuple[str, dict[str, str], str, str]:
    """What comes before the modules, each module by its name, the entry module's name, what comes after."""
    starts = list(re.finditer(rf"var ([\w$]+)={re.escape(wrapper)}\((?=\(|[\w$]+=>)", script))
    end = re.compile(r"return ([\w$]+)\(\);?\}\)\(\)").search(script, starts[-1].start()) if starts else None
    if end is None or end[1] != starts[-1][1]:
        raise BundleError("plotly.js: its entry module was not found")
    places = [start.start() for start in starts] + [end.start()]
    modules = {start[1]: script[a:b] for start, a, b in zip(starts, places[:-1], places[1:], strict=True)}
    return script[: places[0]], modules, end[1], script[end.start() :]


def _trace_of(modules: Mapping[str, str], name: str) -> str | None:
    """Return the trace that a module is, following those that only pass another one on."""
    text = modules.get(name, "")
    while (forwards := _FORWARDS.search(text)) and len(text) < 200:
        text = modules.get(forwards[1], "")
    found = _TRACE.search(text)
    return None if found is None else found[1]


def _always(modules: Mapping[str, str], wrapper: str) -> list[str]:
    """Modules with something of the bundle's own scope behind them, or beside them in one statement."""
    beside = re.compile(rf"[,;][\w$]+={re.escape(wrapper)}\(")
    return [name for name, text in modules.items() if not text.endswith("});") or beside.search(text)]


def _calls(text: str, modules: Mapping[str, str]) -> set[str]:
    return {name for name in _CALL.findall(text) if name in modules}


def _called(modules: Mapping[str, str], first: Collection[str]) -> set[str]:
    """These modules, and all that they call in turn."""
    kept: set[str] = set()
    to_look_at = list(first)
    while to_look_at:
        name = to_look_at.pop()
        if name not in kept:
            kept.add(name)
            to_look_at += _calls(modules[name], modules)
    return kept
