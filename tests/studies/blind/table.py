"""The board as tables of Markdown, one a kind of cell."""

from __future__ import annotations

from collections import Counter

from .board import Judgement, mean, median, peer_rate, rate
from .cells import CELLS
from .peers import PEERS

Judged = dict[str, list[Judgement]]

COLUMNS = {
    "null": ("says something", "found"),
    "one": ("found", "found"),
    "limit": ("found", "found"),
    "two": ("both found", "both"),
    "unnamed": ("found", "found"),
}
TITLES = {
    "null": "Noise alone",
    "one": "One effect",
    "limit": "One effect at the information limit",
    "two": "Two effects",
    "unnamed": "An effect without a name",
}
MORE = {
    "null": {},
    "one": {
        "one right name, alone": "alone",
        "name or set holds it": "held",
        "right origin": "origin",
        "within 3 std": "parameters",
    },
    "limit": {"one right name, alone": "alone", "name or set holds it": "held"},
    "two": {"nothing else": "nothing_else", "within 3 std": "parameters"},
    "unnamed": {"right covariate": "covariate", "no catalogue name": "no_name"},
}


def markdown(judged: Judged) -> str:
    """Rates with their 95 % intervals (Wilson)."""
    parts = [_section(kind, judged) for kind in TITLES]
    everything = [j for judgements in judged.values() for j in judgements]
    parts.append(f"A wrong single name, over everything: {rate(everything, 'wrong_name')}")
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(kind: str, judged: Judged) -> str:
    cells = [name for name in judged if CELLS[name].kind == kind]
    if not cells:
        return ""
    of_sets, of_errors = kind in ("one", "limit"), kind != "null"
    header = ["", "runs", COLUMNS[kind][0], *MORE[kind]]
    header += ["size of the set (oracle)"] if of_sets else []
    header += ["held-out RMS over the oracle's"] if of_errors else []
    header += list(PEERS)
    rows = []
    for name in cells:
        judgements = judged[name]
        row = [name, str(len(judgements)), str(rate(judgements, COLUMNS[kind][1]))]
        row += [str(rate(judgements, what)) for what in MORE[kind].values()]
        if of_sets:
            sizes = mean(judgements, "set_size"), mean(judgements, "oracle_set_size")
            row.append("" if sizes[0] is None else f"{sizes[0]:.2f} ({sizes[1]:.2f})")
        if of_errors:
            ratio = median(judgements, "held_out_ratio")
            row.append("" if ratio is None else f"{ratio:.3f}")
        row += [str(peer_rate(judgements, peer)) for peer in PEERS]
        rows.append(row)
    peers_say = "says something" if kind == "null" else "exactly the right names"
    lines = [f"**{TITLES[kind]}** (peers: {peers_say})", "", _row(header), _row(["---"] * len(header))]
    return "\n".join([*lines, *map(_row, rows)])


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def commonest(judgements: list[Judgement], count: int = 6) -> str:
    """What was said most often, for whoever looks for the reason."""
    said = Counter(j.said for j in judgements).most_common(count)
    return ", ".join(f"{words} ×{times}" for words, times in said)
