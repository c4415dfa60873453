"""Change stored runs in one transaction, with fits that take seconds computed before it begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from calrig.analysis.errors import Conflict
from calrig.calibration.poses import DiagnosisError
from calrig.processes.pool import run_in_subprocess

if TYPE_CHECKING:
    from calrig.store import Store

T = TypeVar("T")

MOST_FITS = 4
"""Of one change: it needs one, and another one each time that its data change during the fit."""


class _NotComputed(Exception):  # noqa: N818 (a request, not an error)
    """A change needs the result of this fit."""

    def __init__(self, fit: partial[Any]) -> None:
        super().__init__()
        self.fit = fit


@dataclass(frozen=True, slots=True)
class _Computed:
    fit: partial[Any]
    result: Any = None
    error: DiagnosisError | None = None


class Fits:
    """Results of fits, computed outside of the transaction that uses them."""

    def __init__(self) -> None:
        self._computed: list[_Computed] = []

    def __call__(self, fit: partial[T]) -> T:
        """Return the result of a fit; stop the change if it is not known for exactly these data.

        Raises:
            DiagnosisError: as the fit does.
        """
        for one in self._computed:
            if (one.fit.func, one.fit.args, one.fit.keywords) == (fit.func, fit.args, fit.keywords):
                if one.error is not None:
                    raise one.error
                result: T = one.result
                return result
        raise _NotComputed(fit)

    def compute(self, fit: partial[Any]) -> None:
        """Carry out a fit in a process of its own and remember its result."""
        try:
            self._computed.append(_Computed(fit, run_in_subprocess(fit)))
        except DiagnosisError as error:
            self._computed.append(_Computed(fit, error=error))


def in_one_transaction(store: Store, change: Callable[[Fits], T]) -> T:
    """Carry out a change with all that follows from it in one transaction, or nothing of it.

    A change that needs a fit is rolled back, and repeated once the fit is computed. It then reads everything
    again, so that it uses the fit only if the data are still those of the fit.

    `change` reads and writes the store; it takes `Fits` for what takes seconds.

    Raises:
        Conflict: the data changed during each of `MOST_FITS` fits.
    """
    fits = Fits()
    for _ in range(MOST_FITS):
        try:
            with store.transaction():
                return change(fits)
        except _NotComputed as needed:
            wanted = needed.fit
        fits.compute(wanted)
    raise Conflict(
        "other requests changed the runs of this unit while its effects were fitted: look at it again, and "
        "repeat the request"
    )
