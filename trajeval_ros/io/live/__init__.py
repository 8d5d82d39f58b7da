"""What a live run leaves on disk."""
