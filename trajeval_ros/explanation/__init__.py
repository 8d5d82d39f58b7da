"""Which definition gives a published number."""
