"""What a user may have got wrong: warnings, restarts, clocks that seem to differ."""
