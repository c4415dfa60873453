"""A static log → what kind of noise, how much: Allan deviation, spectrum, lines, distribution. Pure."""
