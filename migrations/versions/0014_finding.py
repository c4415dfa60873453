"""Finding runs by text, kind and what they follow; and analyses of logs that people brought, kept."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
FOLLOWS, IMPORTED = sa.text("follows IS NOT NULL"), sa.text("plan IS NULL")


def upgrade() -> None:
    op.create_index("ix_run_kind_created_at_id", "run", ["kind", "created_at", "id"])
    op.create_index("ix_run_follows", "run", ["follows"], sqlite_where=FOLLOWS, postgresql_where=FOLLOWS)
    op.create_index(
        "ix_run_imported", "run", ["created_at", "id"], sqlite_where=IMPORTED, postgresql_where=IMPORTED
    )
    if op.get_bind().dialect.name == "sqlite":  # a note may be longer than PostgreSQL has in an index
        op.create_index(
            "ix_run_search", "run", ["created_at", "id", "unit", "rig", "status", "kind", "note"]
        )
    op.create_table(
        "log_study",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("created_at", sa.String(32), nullable=False),
        sa.Column("studied_by", sa.String()),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("file_name", sa.String(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
    )
    op.create_index("ix_log_study_created_at_id", "log_study", ["created_at", "id"])
