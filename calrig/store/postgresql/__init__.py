"""PostgreSQL's own cares: many writers at once, who is told of what, what the server reports."""
