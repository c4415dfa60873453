"""Lists of units to be calibrated one after the other; ends of runs that another program is to be told of."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    op.create_table(
        "batch",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("created_at", sa.String(32), nullable=False),
        sa.Column("closed_at", sa.String(32)),
        sa.Column("document", sa.JSON(), nullable=False),
    )
    op.create_index("ix_batch_created_at", "batch", ["created_at"])
    op.create_table(
        "batch_unit",
        sa.Column("batch", sa.String(), sa.ForeignKey("batch.id"), primary_key=True),
        sa.Column("position", sa.Integer(), primary_key=True),
        sa.Column("unit", sa.String(), nullable=False),
        sa.Column("rig", sa.String()),
        sa.Column("run_uid", sa.String()),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("why", sa.String()),
    )
    op.create_table(
        "webhook_delivery",
        sa.Column("run_uid", sa.String(), primary_key=True),
        sa.Column("ended_at", sa.String(32), nullable=False),
        sa.Column("due_at", sa.String(32)),
        sa.Column("tries", sa.Integer(), nullable=False),
        sa.Column("delivered_at", sa.String(32)),
        sa.Column("error", sa.String()),
    )
    op.create_index("ix_webhook_delivery_due_at", "webhook_delivery", ["due_at"])
