"""SQLite engine: the file, its single writer, write-ahead log, copies, error messages."""
