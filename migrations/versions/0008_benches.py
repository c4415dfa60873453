"""Benches, what they are to do and what they deliver; on a bench, what it took and delivered."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    op.create_table(
        "bench",
        sa.Column("name", sa.String(), primary_key=True),
        sa.Column("hall", sa.String()),
        sa.Column("role", sa.String(), unique=True),
        sa.Column("code_sha256", sa.String(64)),
        sa.Column("code_until", sa.String(32)),
        sa.Column("enrolled_at", sa.String(32)),
        sa.Column("revoked_at", sa.String(32)),
        sa.Column("last_seen_at", sa.String(32)),
        sa.Column("said", sa.JSON(), nullable=False),
    )
    op.create_table(
        "run_order",
        sa.Column("run_uid", sa.String(), primary_key=True),
        sa.Column("bench", sa.String(), sa.ForeignKey("bench.name"), nullable=False),
        sa.Column("rig", sa.String(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("wish", sa.String(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("taken_epoch", sa.Integer(), nullable=False),
        sa.Column("ordered_at", sa.String(32), nullable=False),
    )
    op.create_index("ix_run_order_bench", "run_order", ["bench"])
    op.create_table(
        "bench_command",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("bench", sa.String(), sa.ForeignKey("bench.name"), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("rig", sa.String()),
        sa.Column("run_uid", sa.String()),
        sa.Column("asked_at", sa.String(32), nullable=False),
        sa.Column("taken_at", sa.String(32)),
        sa.Column("answered_at", sa.String(32)),
        sa.Column("withdrawn_at", sa.String(32)),
        sa.Column("answer", sa.JSON()),
    )
    op.create_index("ix_bench_command_bench", "bench_command", ["bench"])
    op.create_table(
        "parcel",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("bench", sa.String(), sa.ForeignKey("bench.name"), nullable=False),
        sa.Column("seq", sa.Integer(), nullable=False),
        sa.Column("run_uid", sa.String(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("data", sa.LargeBinary()),
        sa.Column("delivered_at", sa.String(32), nullable=False),
    )
    op.create_index("ix_parcel_bench_seq", "parcel", ["bench", "seq"], unique=True)
    op.create_table(
        "taken_order",
        sa.Column("run_uid", sa.String(), primary_key=True),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
    )
    op.create_table(
        "delivery",
        sa.Column("run_uid", sa.String(), primary_key=True),
        sa.Column("event_seq", sa.Integer(), nullable=False),
        sa.Column("sample_block_id", sa.Integer(), nullable=False),
        sa.Column("is_complete", sa.Boolean(), nullable=False),
    )
