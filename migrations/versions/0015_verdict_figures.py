"""What verdicts follow from, narrow; runs that are there are judged when they are sought by their verdict first."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
FIGURES = (
    "largest_error_deg",
    "error_expanded_deg",
    "bias_deg",
    "bias_expanded_deg",
    "scale",
    "scale_expanded",
    "rms_deg",
    "rms_expanded_deg",
    "expanded_deg",
)


def upgrade() -> None:
    op.create_table(
        "verdict_figures",
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("run.id"), primary_key=True),
        sa.Column("program", sa.String(), nullable=False),
        sa.Column("left", sa.String()),
        sa.Column("without", sa.String()),
        sa.Column("relied_on", sa.Boolean()),
        *(sa.Column(name, sa.Float()) for name in FIGURES),
    )
    op.execute("INSERT INTO verdict_figures (run_id, program) SELECT id, '' FROM run WHERE result IS NOT NULL")
