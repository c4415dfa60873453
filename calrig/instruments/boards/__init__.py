"""Boards: a folder a device, found by its `DEVICE`, and beside them what several share."""
