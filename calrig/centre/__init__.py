"""The centre: runs that benches carry out, their deliveries, and commands to benches."""
