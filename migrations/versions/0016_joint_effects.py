"""What accepted effects were fitted to, with standard errors; null of effects accepted before."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    op.add_column("accepted_effect", sa.Column("fit", sa.JSON()))
