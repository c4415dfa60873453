"""Issued calibrations with their states, limits, users, check units, and the trail of who did what."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    op.create_table(
        "issued_calibration",
        sa.Column("unit", sa.String(), sa.ForeignKey("unit.serial"), primary_key=True),
        sa.Column("revision", sa.Integer(), primary_key=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), nullable=False),
        sa.Column("document", sa.String(), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("status", sa.String(), nullable=False),
        sa.Column("basis", sa.JSON(), nullable=False),
        sa.Column("verdict", sa.JSON(), nullable=False),
        sa.Column("issued_at", sa.String(32), nullable=False),
        sa.Column("issued_by", sa.String()),
        sa.Column("reason", sa.String()),
    )
    # At most one is in force: the database itself refuses a second.
    op.create_index(
        "ix_issued_calibration_in_force",
        "issued_calibration",
        ["unit"],
        unique=True,
        sqlite_where=sa.text("status = 'in_force'"),
        postgresql_where=sa.text("status = 'in_force'"),
    )
    op.create_index("ix_issued_calibration_run_id", "issued_calibration", ["run_id"])
    op.create_table(
        "trail",
        sa.Column("seq", sa.Integer(), primary_key=True),
        sa.Column("at", sa.String(32), nullable=False),
        sa.Column("who", sa.String()),
        sa.Column("what", sa.String(), nullable=False),
        sa.Column("unit", sa.String()),
        sa.Column("rig", sa.String()),
        sa.Column("run_id", sa.Integer()),
        sa.Column("revision", sa.Integer()),
        sa.Column("reason", sa.String()),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
    )
    op.create_index("ix_trail_unit", "trail", ["unit"])
    op.create_table(
        "limit_rule",
        sa.Column("position", sa.Integer(), primary_key=True),
        sa.Column("name", sa.String(), nullable=False, unique=True),
        sa.Column("document", sa.JSON(), nullable=False),
    )
    op.create_table(
        "user",
        sa.Column("name", sa.String(), primary_key=True),
        sa.Column("role", sa.String(), nullable=False),
        sa.Column("token_sha256", sa.String(64), unique=True),
        sa.Column("created_at", sa.String(32), nullable=False),
        sa.Column("disabled_at", sa.String(32)),
    )
    op.create_table(
        "check_unit",
        sa.Column("rig", sa.String(), primary_key=True),
        sa.Column("unit", sa.String(), sa.ForeignKey("unit.serial"), nullable=False),
        sa.Column("interval_days", sa.Float(), nullable=False),
        sa.Column("named_at", sa.String(32), nullable=False),
    )
    with op.batch_alter_table("accepted_effect") as accepted:
        accepted.add_column(sa.Column("withdrawn_at", sa.String(32)))
