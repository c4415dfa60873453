"""SQLite's own cares: its file, who may write to it, its write-ahead log, copies of it, what it reports."""
