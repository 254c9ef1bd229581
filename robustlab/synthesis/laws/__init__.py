"""What a controller may look like."""
