"""The things that everything speaks of, each typed once: plan, run, result, verdict, limit.

Imports nothing of calrig. What one of them is made of stands in its module; what is done with it, elsewhere.
"""
