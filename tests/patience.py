"""How long a test waits for what has to come: on a machine that is busy, too. Only a fault takes as long."""

PATIENCE = 900.0  # s
