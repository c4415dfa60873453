"""The blind board: runs with effects that the diagnosis is not told of, and how often it is right."""
