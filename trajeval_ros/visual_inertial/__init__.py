"""Visual-inertial estimation: what handling its gauge freedom changes, and what it doesn't.

Zhang, Gallego and Scaramuzza, *On the Comparison of Gauge Freedom Handling in Optimization-Based
Visual-Inertial State Estimation*, RA-L 2018 ("the gauge paper"). Returns arrays.
"""
