"""H-infinity synthesis: two Riccati equations, mixed sensitivity, loop shaping."""
