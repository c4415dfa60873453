"""Background tasks in their own processes, apart from the process that holds the ports."""
