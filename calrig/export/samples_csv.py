"""A run's raw samples as CSV and npz, under the names of CONTRACT section 4's static logs.

Each sample has its pose, and whether it belongs to the move to that pose or to the dwell there.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.store.records import RawSamples, SampleBlock

COLUMNS = (
    "time_s",
    "accel_x_g",
    "accel_y_g",
    "accel_z_g",
    "gyro_x_dps",
    "gyro_y_dps",
    "gyro_z_dps",
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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for block in blocks:
        columns = sample_columns(block)
        if not names:
            names = list(columns)
            writer.writerow(names)
        for first in range(0, len(block), _ROWS_A_PIECE):
            piece = (columns[name][first : first + _ROWS_A_PIECE].tolist() for name in names)
            writer.writerows(
                ["" if math.isnan(value) else repr(value) for value in row]
                for row in zip(*piece, strict=True)
            )
            if text.tell() > _CHARACTERS_A_PIECE:
                yield text.getvalue()
                text.seek(0)
                text.truncate()
    if not names:
        writer.writerow(COLUMNS)
    yield text.getvalue()


def write_samples_npz(samples: RawSamples) -> bytes:
    """The samples as a compressed npz with one array a column."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **sample_columns(samples))
    return buffer.getvalue()


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
