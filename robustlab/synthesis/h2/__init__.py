"""H2, LQG and state feedback; H2 under an H-infinity bound."""
