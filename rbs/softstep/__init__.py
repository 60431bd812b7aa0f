"""softstep."""
