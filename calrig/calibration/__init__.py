"""Poses → bias and scale, and what they are worth. Pure: arrays in, results out."""
