"""Runs the migrations on the connection that `calrig.store.migrate` hands over, inside its transaction.

To change the tables: edit calrig/store/tables.py, add versions/NNNN_what_changes.py (NNNN one more than the
last, `revision` the same four digits), and let tests/store/test_store_migrations.py compare the two.
"""

from alembic import context

from calrig.store import bench_tables  # noqa: F401 (its tables belong to the metadata)
from calrig.store.tables import SQLModel

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=SQLModel.metadata,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
