"""What the author of a plugin or of a driver writes against."""
