"""Where stages without homing were left."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    op.create_table(
        "stage_place",
        sa.Column("rig", sa.String(), primary_key=True),
        sa.Column("stage_deg", sa.Float(), nullable=True),
        sa.Column("at", sa.String(32), nullable=False),
    )
