"""Agent of a bench: takes orders and commands of a centre, and delivers runs to it."""
