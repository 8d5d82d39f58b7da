"""Detection and correction of mistakes in the input, and warnings about results."""
