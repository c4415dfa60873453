"""Certificates as they were issued: numbered, their bytes kept."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    op.create_table(
        "certificate",
        sa.Column("number", sa.String(), primary_key=True),
        sa.Column("unit", sa.String(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("issued_at", sa.String(), nullable=False),
        sa.Column("issued_by", sa.String()),
        sa.Column("replaces", sa.String(), unique=True),
        sa.Column("reason", sa.String()),
        sa.Column("settings", sa.JSON(), nullable=False),
        sa.Column("sha256", sa.JSON(), nullable=False),
        sa.Column("trail_seq", sa.Integer(), nullable=False),
        sa.Column("trail_sha256", sa.String(), nullable=False),
        sa.Column("pdf", sa.LargeBinary()),
        sa.Column("dcc", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["unit", "revision"], ["issued_calibration.unit", "issued_calibration.revision"]),
    )
    op.create_index("ix_certificate_unit", "certificate", ["unit", "revision"])
