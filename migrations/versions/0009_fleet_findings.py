"""What a fleet's re-analysis found in each run, kept so that it is found once."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    op.create_table(
        "fleet_finding",
        sa.Column("run_uid", sa.String(), primary_key=True),
        sa.Column("poses_sha256", sa.String(64), nullable=False),
        sa.Column("catalogue", sa.String(64), nullable=False),
        sa.Column("diagnosis", sa.JSON()),
        sa.Column("error", sa.String()),
        sa.Column("at", sa.String(32), nullable=False),
    )
