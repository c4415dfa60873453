"""Runs are known by an id of their own, no more by the number of their row; the list is ordered by time."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    with op.batch_alter_table("run") as run:
        run.add_column(sa.Column("uid", sa.String()))
    # Whoever has the id of an older run has its number.
    op.execute("UPDATE run SET uid = CAST(id AS VARCHAR)")
    with op.batch_alter_table("run") as run:
        run.alter_column("uid", existing_type=sa.String(), nullable=False)
        run.drop_index("ix_run_unit_id")
        run.drop_index("ix_run_status")
        run.create_index("ix_run_uid", ["uid"], unique=True)
        run.create_index("ix_run_created_at_id", ["created_at", "id"])
        run.create_index("ix_run_unit_created_at_id", ["unit", "created_at", "id"])
        run.create_index("ix_run_rig_created_at_id", ["rig", "created_at", "id"])
        run.create_index("ix_run_status_created_at_id", ["status", "created_at", "id"])
    with op.batch_alter_table("trail") as trail:
        trail.alter_column("run_id", existing_type=sa.Integer(), type_=sa.String())
