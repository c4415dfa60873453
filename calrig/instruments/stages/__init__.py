"""Stage controllers: a folder a device with its driver and its words."""
