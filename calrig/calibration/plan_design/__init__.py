"""The plan that reaches an uncertainty soonest on a rig: CONTRACT section 9."""
