"""Effects that a person accepted, of a unit or of a rig."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    op.create_table(
        "accepted_effect",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), nullable=False),
        sa.Column("unit", sa.String(), sa.ForeignKey("unit.serial")),
        sa.Column("rig", sa.String()),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("origin", sa.String(), nullable=False),
        sa.Column("parameters", sa.JSON(), nullable=False),
        sa.Column("accepted_at", sa.String(32), nullable=False),
    )
    op.create_index("ix_accepted_effect_unit", "accepted_effect", ["unit"])
    op.create_index("ix_accepted_effect_rig", "accepted_effect", ["rig"])
