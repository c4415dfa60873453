"""Heavy work in processes of its own, beside the one that holds the ports."""
