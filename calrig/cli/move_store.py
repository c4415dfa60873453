"""`move-store`: a whole store into an empty one, on whichever engines, proven by checksums."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from calrig.cli.options import Json

Named = Annotated[
    str, typer.Argument(metavar="FROM", help="The store to take over: a path or a URL; it is not changed.")
]
Into = Annotated[str, typer.Argument(metavar="TO", help="An empty store, made where there is none.")]


def move_store(from_: Named, to: Into, json: Json = False) -> None:
    """Copy a whole store into an empty one, from SQLite to PostgreSQL or back, and compare the two.

    Every checksum is verified on the way; TO has all of it or, where anything goes wrong, nothing.
    """
    from calrig.cli.output import print_json, print_moved, print_says
    from calrig.cli.progress import late_bar
    from calrig.settings import store_url
    from calrig.store.moving import move_store as move

    with late_bar("moving the store") as told:
        moved = move(store_url(from_), store_url(to), told)
    print_says(moved.says)
    if json:
        print_json({"tables": [asdict(t) for t in moved.tables], "duration_s": moved.duration_s})
    else:
        print_moved(moved)
