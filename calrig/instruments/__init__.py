"""What hangs on a wire: opening ports, framing, stage drivers, board drivers."""
