"""What a bench does beside carrying runs out: takes a centre's orders and commands, and delivers to it."""
