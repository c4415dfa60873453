"""Joint solutions of runs of one rig: what was found, each unit's calibration, and the stage's map."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    op.create_table(
        "solution",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("created_at", sa.String(32), nullable=False),
        sa.Column("solved_by", sa.String()),
        sa.Column("rig", sa.String()),
        sa.Column("basis", sa.JSON(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("calibrations", sa.JSON(), nullable=False),
        sa.Column("stage_map", sa.JSON(), nullable=False),
        sa.Column("poses", sa.JSON(), nullable=False),
    )
    op.create_index("ix_solution_rig_created_at", "solution", ["rig", "created_at"])
