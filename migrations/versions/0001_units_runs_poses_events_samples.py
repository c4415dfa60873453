"""Units, runs with their figures, poses, events and raw samples."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    op.create_table(
        "unit",
        sa.Column("serial", sa.String(), primary_key=True),
        sa.Column("created_at", sa.String(32), nullable=False),
    )
    op.create_table(
        "run",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("unit", sa.String(), sa.ForeignKey("unit.serial"), nullable=False),
        sa.Column("rig", sa.String()),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("status", sa.String(), nullable=False),
        sa.Column("plan", sa.JSON()),
        sa.Column("progress", sa.JSON(), nullable=False),
        sa.Column("result", sa.JSON()),
        sa.Column("diagnosis", sa.JSON()),
        sa.Column("faults", sa.JSON(), nullable=False),
        sa.Column("follows", sa.Integer(), sa.ForeignKey("run.id")),
        sa.Column("provenance", sa.JSON(), nullable=False),
        sa.Column("operator", sa.String()),
        sa.Column("note", sa.String()),
        sa.Column("voided_reason", sa.String()),
        sa.Column("voided_at", sa.String(32)),
        sa.Column("created_at", sa.String(32), nullable=False),
        sa.Column("started_at", sa.String(32)),
        sa.Column("finished_at", sa.String(32)),
        sa.Column("error", sa.String()),
    )
    op.create_index("ix_run_unit_id", "run", ["unit", "id"])
    op.create_index("ix_run_status", "run", ["status"])
    op.create_table(
        "calibration",
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), primary_key=True),
        sa.Column("bias_deg", sa.Float(), nullable=False),
        sa.Column("bias_std_deg", sa.Float()),
        sa.Column("scale", sa.Float()),
        sa.Column("scale_std", sa.Float()),
        sa.Column("rms_raw_deg", sa.Float(), nullable=False),
        sa.Column("rms_calibrated_deg", sa.Float()),
        sa.Column("rms_with_effects_deg", sa.Float()),
        sa.Column("temperature_min_c", sa.Float()),
        sa.Column("temperature_max_c", sa.Float()),
    )
    op.create_table(
        "pose",
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), primary_key=True),
        sa.Column("pose_index", sa.Integer(), primary_key=True),
        sa.Column("target_deg", sa.Float(), nullable=False),
        sa.Column("reading_deg", sa.Float(), nullable=False),
        sa.Column("sweep", sa.Integer()),
        sa.Column("approach", sa.Integer()),
        sa.Column("time_s", sa.Float()),
        sa.Column("temperature_c", sa.Float()),
        sa.Column("stage_deg", sa.Float()),
        sa.Column("reading_std_deg", sa.Float()),
        sa.Column("reading_stderr_deg", sa.Float()),
        sa.Column("n_samples", sa.Integer()),
        sa.Column("accel_x_g", sa.Float()),
        sa.Column("accel_y_g", sa.Float()),
        sa.Column("accel_z_g", sa.Float()),
        sa.Column("gyro_move_deg", sa.Float()),
        sa.Column("settle_s", sa.Float()),
        sa.Column("covariates", sa.JSON(), nullable=False),
        sa.Column("excluded_reason", sa.String()),
        sa.Column("excluded_at", sa.String(32)),
    )
    op.create_table(
        "event",
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), primary_key=True),
        sa.Column("seq", sa.Integer(), primary_key=True),
        sa.Column("type", sa.String(), nullable=False),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.Column("at", sa.String(32), nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "sample_block",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), nullable=False),
        sa.Column("pose_index", sa.Integer(), nullable=False),
        sa.Column("phase", sa.String(), nullable=False),
        sa.Column("n_samples", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
    )
    op.create_index("ix_sample_block_run_id_pose_index", "sample_block", ["run_id", "pose_index"])
