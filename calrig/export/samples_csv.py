"""A run's raw samples as CSV and npz, under the names of CONTRACT section 4's static logs.

Each sample has its pose, and whether it belongs to the move to that pose or to the dwell there.
"""

import io
import math
from collections.abc import Iterable, Iterator

import numpy as np

from calrig.estimation.angles import AXES, FloatArray
from calrig.export.csv_dialect import csv_text
from calrig.store.records import RawSamples, SampleBlock

COLUMNS = (
    "time_s",
    *(f"accel_{axis}_g" for axis in AXES),
    *(f"gyro_{axis}_dps" for axis in AXES),
    "temperature_c",
)
_ROWS_A_PIECE = 500
_CHARACTERS_A_PIECE = 30_000


def sample_columns(samples: RawSamples) -> dict[str, FloatArray]:
    """The samples as one (n,) array a column; what the board does not send is NaN.

    `angle_deg`, the elevation as the board computed it, is there only where the board sends it.
    """
    table = np.column_stack((samples.time_s, samples.accel_g, samples.gyro_dps, samples.temperature_c))
    columns: dict[str, FloatArray] = {name: table[:, place] for place, name in enumerate(COLUMNS)}
    if samples.angle_deg is not None:
        columns["angle_deg"] = samples.angle_deg
    return columns


def write_samples_csv(blocks: Iterable[RawSamples]) -> Iterator[str]:
    """The samples as CSV, piece by piece; a number reads back exactly, NaN is an empty cell.

    `blocks` come one after the other; the first says whether the board sends its angle.
    """
    names: list[str] = []
    text = ""
    for block in blocks:
        columns = sample_columns(block)
        if not names:
            names = list(columns)
            text = csv_text([names])
        table = np.column_stack([columns[name] for name in names])
        for rows in _rows(table):
            text += rows
            if len(text) > _CHARACTERS_A_PIECE:
                yield text
                text = ""
    yield text if names else csv_text([COLUMNS])


def write_samples_npz(samples: RawSamples) -> bytes:
    """The samples as a compressed npz with one array a column."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **sample_columns(samples))
    return buffer.getvalue()


def labelled_samples(blocks: Iterable[SampleBlock]) -> Iterator[bytes]:
    """Rows in the order taken, piece by piece; a number reads back exactly, NaN is an empty cell.

    The last column, `angle_deg`, is the elevation as the board computed it, empty where it sends none.
    """
    yield csv_text([["pose", "phase", *COLUMNS, "angle_deg"]]).encode()
    for block in blocks:
        unknown = np.full(len(block.time_s), math.nan)
        angle_deg = unknown if block.angle_deg is None else block.angle_deg
        numbers = (block.time_s, block.accel_g, block.gyro_dps, block.temperature_c, angle_deg)
        for rows in _rows(np.column_stack(numbers), str(block.pose_index), block.phase):
            yield rows.encode()


def _rows(table: FloatArray, *label: str) -> Iterator[str]:
    """The lines of a table (n, columns), some at a time, each behind its label."""
    for first in range(0, len(table), _ROWS_A_PIECE):
        yield csv_text(
            [*label, *("" if math.isnan(value) else repr(value) for value in row)]
            for row in table[first : first + _ROWS_A_PIECE].tolist()
        )
