"""Where every design starts and ends: partition, assumptions, scaling; the rebuilt loop and its certificate."""
