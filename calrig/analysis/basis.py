"""What a unit's calibration rests on: told here when it has changed after it was measured."""

from __future__ import annotations

from calrig.store import Run, Store


def changed(store: Store, run: Run, who: str | None) -> None:
    """Called once a run, one of its poses or an effect accepted from it counts that did not, or no more.

    Args:
        store: where it is.
        run: as it is now; one that was moved as it was, too, for the unit it was taken for.
        who: did it; None where nobody is known by name.
    """
