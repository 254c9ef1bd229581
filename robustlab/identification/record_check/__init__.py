"""Is a record what it is taken for: quality, channels, clock, data sheets, fitness for naming."""
