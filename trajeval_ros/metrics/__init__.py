"""The tutorial: association, alignment, absolute and relative errors, statistics, protocols."""
