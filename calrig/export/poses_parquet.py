"""Poses of many runs as Parquet, for everybody else's tools and for the screen of a fleet, and back.

One file holds some thousand runs, a row a pose: `run_id`, `unit`, `rig`, then CONTRACT section 4's columns by
their names there, then covariates. What is not known is null.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calrig.calibration.packed_poses import PackedPoses
from calrig.calibration.poses import INTEGER, REQUIRED
from calrig.errors import InputError, WorkError

POSES_A_FILE = 2_000_000
OF_RUN = ("run_id", "unit", "rig")
EXTRA = "pip install 'calrig[fleet]'"


def write_poses(folder: Path, pieces: Iterable[PackedPoses]) -> list[Path]:
    """Writes poses as files `poses-00000.parquet`, … into a folder that has none yet.

    `folder` is made where there is none; `pieces` are runs, each once.

    Raises:
        InputError: there are such files already.
        WorkError: pyarrow is not installed, or the files cannot be written.
    """
    pa = _pyarrow()
    from pyarrow import parquet

    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if next(folder.glob("*.parquet"), None) is not None:
            raise InputError(
                f"{folder}: holds Parquet files already, and none is overwritten: name another folder"
            )
        for number, some in enumerate(_files(pieces)):
            tables = [_table(pa, piece) for piece in some]
            path = folder / f"poses-{number:05d}.parquet"
            # a half-written file has a temporary name
            unfinished = path.with_suffix(".part")
            parquet.write_table(pa.concat_tables(tables, promote_options="default"), unfinished)
            unfinished.rename(path)
            written.append(path)
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({error})") from error
    return written


def parquet_files(source: Path) -> list[Path]:
    """The files of a folder in the order of their names, or the file itself; InputError without any."""
    files = sorted(source.glob("*.parquet")) if source.is_dir() else [source]
    if not files or not files[0].is_file():
        raise InputError(f"{source}: there is no Parquet file: `calrig export --parquet DIR` writes some")
    return files


def read_file(file: Path) -> Iterator[PackedPoses]:
    """The runs of a Parquet file, some at a time, each whole.

    `file` is as `write_poses` made it, or has at least `run_id`, `target_deg` and `reading_deg`, the poses of
    a run one after the other, none of them in another file. Every numeric column is read.

    Raises:
        InputError: it is no such file.
        WorkError: pyarrow is not installed.
    """
    pa = _pyarrow()
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(file) as opened:
            names = _wanted(pa, opened.schema_arrow, file)
            held: Any = None
            for group in range(opened.num_row_groups):
                table = opened.read_row_group(group, columns=names, use_threads=False)
                table = table if held is None else pa.concat_tables([held, table])
                # the last run of a group may go on in the next
                whole = int(_beginnings(table)[-1]) if group + 1 < opened.num_row_groups else len(table)
                held = table.slice(whole)
                if whole:
                    yield _packed(table.slice(0, whole), names)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{file}: is no Parquet file of poses ({error})") from error


def _pyarrow() -> Any:
    try:
        import pyarrow
    except ImportError as error:
        raise WorkError(f"Parquet needs pyarrow: {EXTRA}") from error
    return pyarrow


def _files(pieces: Iterable[PackedPoses]) -> Iterator[list[PackedPoses]]:
    """Pieces that go into a file each."""
    some: list[PackedPoses] = []
    for piece in pieces:
        some.append(piece)
        if sum(int(one.first[-1]) for one in some) >= POSES_A_FILE:
            yield some
            some = []
    if some:
        yield some


def _table(pa: Any, piece: PackedPoses) -> Any:
    of_pose = pa.array(np.repeat(np.arange(len(piece)), piece.counts), pa.int32())
    columns: dict[str, Any] = {}
    for name, of_run in zip(OF_RUN, (piece.run_ids, piece.units, piece.rigs), strict=True):
        columns[name] = pa.array(of_run, pa.string()).take(of_pose)
    for name, column in piece.columns.items():
        number = pa.array(column, pa.float64(), from_pandas=True)  # NaN is null
        columns[name] = number.cast(pa.int64()) if name in INTEGER else number
    return pa.table(columns)


def _wanted(pa: Any, schema: Any, file: Path) -> list[str]:
    """Names of the columns to read, those of runs first."""
    numbers = [f.name for f in schema if pa.types.is_floating(f.type) or pa.types.is_integer(f.type)]
    lacking = [name for name in ("run_id", *REQUIRED) if name not in schema.names]
    if lacking:
        raise InputError(f"{file}: has no column {lacking[0]}")
    return [
        *(name for name in OF_RUN if name in schema.names),
        *(name for name in numbers if name not in OF_RUN),
    ]


def _beginnings(table: Any) -> np.ndarray[Any, np.dtype[np.intp]]:
    """The rows where another run begins."""
    import pyarrow.compute as pc

    ids = table["run_id"].combine_chunks()
    if len(ids) == 0:
        return np.zeros(1, dtype=np.intp)
    changes = pc.not_equal(ids.slice(1), ids.slice(0, len(ids) - 1)).to_numpy(zero_copy_only=False)
    return np.concatenate([[0], 1 + np.flatnonzero(changes)])


def _packed(table: Any, names: Sequence[str]) -> PackedPoses:
    begins = _beginnings(table)
    of_run = table.select([name for name in OF_RUN if name in names]).take(begins)
    ids, units, rigs = (
        tuple(of_run[name].to_pylist()) if name in names else (None,) * len(begins) for name in OF_RUN
    )
    columns = {name: table[name].to_numpy().astype(np.float64) for name in names if name not in OF_RUN}
    first = np.append(begins, len(table)).astype(np.intp)
    return PackedPoses(tuple(map(str, ids)), first, columns, units, rigs)
