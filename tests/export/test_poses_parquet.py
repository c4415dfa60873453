"""Poses as Parquet: what other tools read in them, and that they come back as they were."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.packed_poses import PackedPoses, packed
from calrig.calibration.poses import Pose
from calrig.errors import InputError
from calrig.export.poses_parquet import parquet_files, read_file, write_poses

pa = pytest.importorskip("pyarrow")
from pyarrow import parquet  # noqa: E402


def two_runs() -> PackedPoses:
    first = [Pose(10.0 * k, 10.1 * k, sweep=0, approach=1, temperature_c=20.5) for k in range(3)]
    second = [Pose(0.0, 0.1, n_samples=400, covariates={"humidity": 0.4}), Pose(5.0, 5.1)]
    made = packed({"run-1": first, "run-2": second})
    return PackedPoses(made.run_ids, made.first, made.columns, ("A", "B"), ("bench-1", None))


def assert_same(found: PackedPoses, expected: PackedPoses) -> None:
    assert (found.run_ids, found.units, found.rigs) == (expected.run_ids, expected.units, expected.rigs)
    assert found.first.tolist() == expected.first.tolist()
    assert set(found.columns) == set(expected.columns)
    for name, column in expected.columns.items():
        np.testing.assert_array_equal(found.columns[name], column, name)


def test_other_tools_find_the_contracts_columns_and_nulls(tmp_path):
    (file,) = write_poses(tmp_path / "poses", [two_runs()])
    table = parquet.read_table(file)
    assert table.column_names[:6] == ["run_id", "unit", "rig", "target_deg", "reading_deg", "pass"]
    rows = table.to_pylist()
    assert rows[0]["pass"] == 0
    assert rows[0]["temperature_c"] == 20.5
    assert (rows[3]["run_id"], rows[3]["unit"], rows[3]["rig"]) == ("run-2", "B", None)
    assert (rows[3]["n_samples"], rows[4]["n_samples"], rows[4]["humidity"]) == (400, None, None)


def test_poses_come_back_as_they_were(tmp_path):
    write_poses(tmp_path, [two_runs()])
    (file,) = parquet_files(tmp_path)
    (found,) = read_file(file)
    assert_same(found, two_runs())


def test_a_run_across_two_row_groups_is_one_run(tmp_path):
    (file,) = write_poses(tmp_path, [two_runs()])
    parquet.write_table(parquet.read_table(file), file, row_group_size=2)
    found = list(read_file(file))
    assert [run for piece in found for run in piece.run_ids] == ["run-1", "run-2"]
    assert [n for piece in found for n in piece.counts.tolist()] == [3, 2]


def test_nothing_is_overwritten_and_what_is_no_table_of_poses_is_said(tmp_path):
    write_poses(tmp_path, [two_runs()])
    with pytest.raises(InputError, match="name another folder"):
        write_poses(tmp_path, [two_runs()])
    other, text = tmp_path / "other.parquet", tmp_path / "text.parquet"
    parquet.write_table(pa.table({"run_id": ["a"], "target_deg": [1.0]}), other)
    text.write_text("target_deg,reading_deg\n")
    with pytest.raises(InputError, match=r"other\.parquet: has no column reading_deg"):
        list(read_file(other))
    with pytest.raises(InputError, match=r"text\.parquet: is no Parquet file"):
        list(read_file(text))
    with pytest.raises(InputError, match="there is no Parquet file"):
        parquet_files(tmp_path / "absent")
