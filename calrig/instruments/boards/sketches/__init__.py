"""Boards that already run somebody's sketch and print text."""
