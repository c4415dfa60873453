"""A run's raw samples as CSV, each with its pose and whether it is of the move there or of the dwell."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator

import numpy as np

from calrig.export.samples_csv import COLUMNS
from calrig.store.records import SampleBlock

_ROWS_A_PIECE = 500


def labelled_samples(blocks: Iterable[SampleBlock]) -> Iterator[bytes]:
    """Rows in the order taken, piece by piece; a number reads back exactly, NaN is an empty cell.

    The last column, `angle_deg`, is the elevation as the board computed it, empty where it sends none.
    """
    yield _lines([["pose", "phase", *COLUMNS, "angle_deg"]])
    for block in blocks:
        unknown = np.full(len(block.time_s), math.nan)
        angle_deg = unknown if block.angle_deg is None else block.angle_deg
        numbers = (block.time_s, block.accel_g, block.gyro_dps, block.temperature_c, angle_deg)
        table = np.column_stack(numbers).tolist()
        label = [str(block.pose_index), block.phase]
        for first in range(0, len(table), _ROWS_A_PIECE):
            yield _lines(
                [*label, *("" if math.isnan(value) else repr(value) for value in row)]
                for row in table[first : first + _ROWS_A_PIECE]
            )


def _lines(rows: Iterable[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
