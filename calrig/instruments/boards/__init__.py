"""Boards: a folder a device, found by its `DEVICE`, and the modules that several share."""
