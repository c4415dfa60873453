"""Newport ESP301."""
