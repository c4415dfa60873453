"""Runs the migrations on the connection that `calrig.store.migrate` hands over, inside its transaction.

To change the tables: edit calrig/store/tables.py, add versions/NNNN_what_changes.py (NNNN one more than the
last, `revision` the same four digits), and let tests/store/test_store_migrations.py compare the two.
"""

from typing import Any

from alembic import context
from sqlalchemy import Connection, text

# their tables belong to the metadata
from calrig.store import bench_tables, tables  # noqa: F401
from calrig.store.tables import SQLModel

TEXT_OF_A_LANGUAGE = """
SELECT table_name, column_name, character_maximum_length FROM information_schema.columns
WHERE table_schema = current_schema() AND table_name = ANY(:ours)
AND data_type = 'character varying' AND collation_name IS DISTINCT FROM 'C'
"""


def order_by_bytes(**_: Any) -> None:
    """Has PostgreSQL order text as SQLite does, whatever language its database was made for.

    Serial numbers, names and times come in one order on both. Before the migrations, for what is there, and
    after each, for what it has added: a column that a policy names cannot be changed any more.
    """
    connection: Connection = context.config.attributes["connection"]
    if connection.dialect.name != "postgresql":
        return
    quote = connection.dialect.identifier_preparer.quote
    found = connection.execute(text(TEXT_OF_A_LANGUAGE), {"ours": list(SQLModel.metadata.tables)})
    for table, column, length in found.all():
        kind = "varchar" if length is None else f"varchar({length})"
        by_bytes = f'ALTER COLUMN {quote(column)} TYPE {kind} COLLATE "C"'
        connection.execute(text(f"ALTER TABLE {quote(table)} {by_bytes}"))


context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=SQLModel.metadata,
    render_as_batch=True,
    on_version_apply=order_by_bytes,
)
with context.begin_transaction():
    order_by_bytes()
    context.run_migrations()
