"""Boards that speak calrig's own packets."""
