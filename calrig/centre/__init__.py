"""A centre's process: runs that its benches carry out, what they deliver, and what is asked of them."""
