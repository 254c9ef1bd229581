"""From what is wanted to a problem (weights, tracking problems), and what a designer looks at in a loop."""
