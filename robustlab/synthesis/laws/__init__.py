"""What a controller may look like: structures that combine, and packed matrices as functions of their parameters."""
