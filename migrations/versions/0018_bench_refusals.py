"""Orders that wait for a person's word, and why benches take none; stops that nobody obeyed are over."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    with op.batch_alter_table("run_order") as run_order:
        run_order.add_column(sa.Column("held_epoch", sa.Integer(), nullable=False, server_default="0"))
    with op.batch_alter_table("bench") as bench:
        bench.add_column(sa.Column("bears", sa.String()))
        bench.add_column(sa.Column("refused", sa.String()))
    op.execute(
        "UPDATE bench_command SET withdrawn_at = asked_at WHERE answered_at IS NULL AND withdrawn_at IS NULL"
    )
