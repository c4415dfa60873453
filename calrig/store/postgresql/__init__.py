"""PostgreSQL engine: concurrent writers, notifications, roles, error messages."""
