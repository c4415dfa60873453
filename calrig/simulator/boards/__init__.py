"""Boards with a protocol of their own: calrig's. Those that print text are in `sketches`."""
