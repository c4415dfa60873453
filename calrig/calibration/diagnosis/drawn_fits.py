"""Full likelihood of candidates in responses drawn from a known noise.

The noise of the draws is known, so that one orthonormal set of columns serves all of them (Frisch & Waugh,
Econometrica 1, 1933).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import Candidate
from calrig.calibration.regression.noise_model import (
    STRONG_RHO,
    NoiseModel,
    RepeatedSteps,
    lagged_products,
    orthonormal,
)
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

Intp = npt.NDArray[np.intp]
BATCH = 32
"""Responses at a time: what belongs to them then stays in the processor's cache."""


class DrawnFits:
    """A model's criterion in responses drawn from a noise, alone and beside each of some candidates.

    `r` has what the poses of all responses have in common; `columns_with` gives the (n, J, p) columns of the
    model with some candidates beside it.
    """

    def __init__(
        self,
        r: Responses,
        columns_with: Callable[[Sequence[Candidate]], FloatArray],
        candidates: Sequence[Candidate],
        noise: NoiseModel,
    ) -> None:
        self._candidates = candidates
        self._models = {"": _Model(r, columns_with(()), noise)}
        for c in candidates:
            if c.shape.replaces and c.shape.replaces not in self._models:
                base = columns_with((c,))[:, :, : -c.columns.shape[2]]
                self._models[c.shape.replaces] = _Model(r, base, noise)
        self._kind_of = [(c.columns.shape[2], c.shape.replaces or "") for c in candidates]

    def null(self, values: FloatArray) -> FloatArray:
        """Return (b,) criterion of the model alone in responses (b, n, J)."""
        return self._models[""].alone(values)

    def beside(self, values: FloatArray, drawn: Intp, chosen: Intp) -> tuple[FloatArray, list[FloatArray]]:
        """Return (m,) criterion in some responses of (b, n, J), each beside a chosen candidate.

        And these candidates' own coefficients. The responses' places `drawn` (m,) are in their order.
        """
        flat = chosen.tolist()
        criterion = np.empty(len(flat))
        own: list[FloatArray] = [np.empty(0)] * len(flat)
        for first in range(0, len(values), BATCH):
            alike: dict[tuple[int, str], list[int]] = {}
            for pair in range(*np.searchsorted(drawn, [first, first + BATCH]).tolist()):
                alike.setdefault(self._kind_of[flat[pair]], []).append(pair)
            for (_, replaced), pairs in alike.items():
                kinds = [flat[pair] for pair in pairs]
                criterion[pairs], betas = self._models[replaced].beside(
                    values[first : first + BATCH],
                    drawn[pairs] - first,
                    kinds,
                    {k: self._candidates[k] for k in kinds},
                )
                for pair, beta in zip(pairs, betas, strict=True):
                    own[pair] = beta
        return criterion, own


class _Columns(NamedTuple):
    """Columns in rows (…, p, n·J), orthonormal once whitened: `white`, and `plain`, as they were before that.

    Coefficients of the columns that they were made of are those of these times `turn` (…, p, p).
    """

    white: FloatArray
    plain: FloatArray
    turn: FloatArray


class _Model:
    """One model (n, J, p) in one noise, and what it leaves of the candidates that were beside it so far."""

    def __init__(self, r: Responses, model: FloatArray, noise: NoiseModel) -> None:
        self._r, self._noise, self._width = r, noise, model.shape[2]
        white, plain = self._rows(model[None])
        base = _orthonormal(white, plain, np.linalg.norm(white, axis=2))
        self._base = _Columns(*(one[0] for one in base))
        self._made: dict[int, _Columns] = {}
        self._again = None
        if noise.rho.max() >= STRONG_RHO:
            self._again = RepeatedSteps(r, self._base.plain[np.any(self._base.plain != 0.0, axis=1)])

    def alone(self, values: FloatArray) -> FloatArray:
        """Return (b,) criterion in responses (b, n, J)."""
        left = self._left(values, self._white(values))
        nothing = np.empty((1, 0, left.shape[1]))
        return self._criterion(left, nothing, np.zeros(len(left), dtype=np.intp))[0]

    def beside(
        self, values: FloatArray, drawn: Intp, kinds: Sequence[int], candidates: dict[int, Candidate]
    ) -> tuple[FloatArray, FloatArray]:
        """Return (m,) criterion and (m, w) coefficients of one candidate each, all of one width.

        Of the responses `values` (b, n, J), `drawn` (m,) are fitted, each with the candidate of its key in
        `kinds` (m,).
        """
        new = [k for k in candidates if k not in self._made]
        if new:
            self._made.update(zip(new, self._orthonormal([candidates[k] for k in new]), strict=True))
        white = self._white(values)
        place = {k: at for at, k in enumerate(candidates)}
        at = np.array([place[k] for k in kinds])
        of_white, of_plain, turn = (
            np.stack(one) for one in zip(*(self._made[k] for k in candidates), strict=True)
        )
        inside = of_white[at] @ white[drawn][:, :, None]
        left = self._left(values, white)[drawn] - (np.swapaxes(inside, 1, 2) @ of_plain[at])[:, 0]
        criterion, more = self._criterion(left, of_plain, at)
        return criterion, (turn[at] @ (inside + more[:, :, None]))[:, :, 0]

    def _orthonormal(self, candidates: Sequence[Candidate]) -> list[_Columns]:
        """Candidates of one width, beside the model."""
        white, plain = self._rows(np.stack([c.columns for c in candidates]))
        inside = white @ self._base.white.T
        size = np.linalg.norm(white, axis=2)
        made = _orthonormal(white - inside @ self._base.white, plain - inside @ self._base.plain, size)
        return [_Columns(*one) for one in zip(*made, strict=True)]

    def _white(self, values: FloatArray) -> FloatArray:
        """Return (…, n·J) responses or columns (…, n, J) whitened."""
        return self._noise.whiten(values, self._r.starts).reshape(*values.shape[:-2], -1)

    def _left(self, values: FloatArray, white: FloatArray) -> FloatArray:
        """Return (b, n·J) what the model leaves of responses (b, n, J), by themselves and whitened."""
        return np.asarray(values.reshape(white.shape) - (white @ self._base.white.T) @ self._base.plain)

    def _criterion(self, left: FloatArray, beside: FloatArray, at: Intp) -> tuple[FloatArray, FloatArray]:
        """Return (m,) of what one step leaves (m, n·J), and (m, w) what further steps add to coefficients.

        Of those columns (k, w, n·J) that it was fitted beside, by their places `at` (m,).
        """
        width = beside.shape[1]
        taken = max(1.0, (self._width + width) / len(self._r.channels))
        if self._again is not None:
            steps = self._again.steps(left, beside, at, taken)
            return steps.products.criterion(*steps.products.noises(taken)), steps.more
        products = lagged_products(left.reshape(-1, *self._r.values.shape), self._r.starts, self._r.rounding)
        return products.criterion(*products.noises(taken)), np.zeros((len(left), width))

    def _rows(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return columns (m, n, J, p) whitened and as they are, in rows (m, p, n·J)."""
        rows = np.moveaxis(columns, 3, 1)
        return self._white(rows), rows.reshape(*rows.shape[:2], -1)


def _orthonormal(white: FloatArray, plain: FloatArray, size: FloatArray) -> _Columns:
    """Of rows (m, p, n·J), of sizes (m, p) before others were taken off them."""
    turn = orthonormal(white @ np.swapaxes(white, 1, 2), size)
    across = np.swapaxes(turn, 1, 2)
    return _Columns(across @ white, across @ plain, turn)
