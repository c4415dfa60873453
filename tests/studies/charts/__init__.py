"""How often control charts of short histories raise a false alarm, and how soon they see a shift."""
