"""Checksums of poses and of the figures in comparisons; documents carry theirs inside."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    crc32 = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
    op.add_column("pose", sa.Column("crc32", crc32, nullable=True))
    op.add_column("calibration", sa.Column("crc32", crc32, nullable=True))
