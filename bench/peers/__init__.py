"""The planner's peers: the same instances and the same answer, by other solvers."""
