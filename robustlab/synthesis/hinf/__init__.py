"""H-infinity: two Riccati equations, the search around them, LMIs behind it, mixed sensitivity, loop shaping."""
