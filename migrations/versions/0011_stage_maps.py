"""Stage maps that were put in force as the reference of a rig, and until when."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
IN_FORCE = sa.text("withdrawn_at IS NULL")


def upgrade() -> None:
    op.create_table(
        "stage_map",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("rig", sa.String(), nullable=False),
        sa.Column("solution_id", sa.String(), sa.ForeignKey("solution.id"), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("put_at", sa.String(32), nullable=False),
        sa.Column("put_by", sa.String()),
        sa.Column("withdrawn_at", sa.String(32)),
    )
    op.create_index(
        "ix_stage_map_in_force",
        "stage_map",
        ["rig"],
        unique=True,
        sqlite_where=IN_FORCE,
        postgresql_where=IN_FORCE,
    )
