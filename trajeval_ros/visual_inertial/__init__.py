"""Visual-inertial estimation, and the effects of handling its gauge freedom.

Zhang, Gallego and Scaramuzza, *On the Comparison of Gauge Freedom Handling in Optimization-Based
Visual-Inertial State Estimation*, RA-L 2018 ("the gauge paper"). Returns arrays.
"""
