"""A rig that is not there: its physics (gravity, mechanics, temperature, noise) and its wire dialects."""
