"""Settings by name, and the requests that they state."""
