"""Models and controllers of lower order, with certified errors."""
